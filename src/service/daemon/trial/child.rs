//! The child of a trial, as its parent sees it: started, watched, and judged by the way it ends.

use crate::service::daemon::places::Place;
use crate::service::telemetry::{Beat, process};
use serde::Serialize;
use std::io::{BufWriter, Read, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Interval between looks at the child.
const LOOK: Duration = Duration::from_millis(10);
/// Longest wait: nothing is learned after it. A step that would hang the daemon is ended by the watchdog, and counted.
const PATIENCE: Duration = Duration::from_mins(2);
/// Memory from which on a killed child died of its own size: no input may need as much \[MB\].
const MOST_MB: f64 = 256.0;

/// Signals that a process brings upon itself, with their names.
const OWN_DOING: [(i32, &str); 7] = [
    (4, "SIGILL"),
    (5, "SIGTRAP"),
    (6, "SIGABRT"),
    (7, "SIGBUS"),
    (8, "SIGFPE"),
    (11, "SIGSEGV"),
    (31, "SIGSYS"),
];
const SIGKILL: i32 = 9;
/// Exit code of a panic.
const PANIC: i32 = 101;

/// The end of a child.
pub(super) enum Ended {
    /// It took the step.
    Well,
    /// It died of it.
    Died {
        /// Predicate of a sentence.
        how: String,
        /// Place where it was.
        at: Option<Place>,
    },
    /// It ended for a reason that says nothing of the step.
    Unclear(String),
    /// It took longer than anybody can wait.
    Late,
    /// The daemon stops.
    Stopped,
}

/// Address space of this process if the system limits it, else 0 \[bytes\].
pub(super) fn limited_space() -> u64 {
    match process::address_space_is_limited() {
        true => process::address_space().unwrap_or(0),
        false => 0,
    }
}

/// Gives a child its case, and waits for its end.
pub(super) fn run(
    program: &Path,
    case: &(impl Serialize + Sync),
    beat: Option<&Beat>,
    is_over: &AtomicBool,
) -> Ended {
    let begun = Command::new(program)
        .arg0("tirante")
        .arg("trial")
        // They are the daemon's alone.
        .env_remove("NOTIFY_SOCKET")
        .env_remove("WATCHDOG_USEC")
        .env_remove("WATCHDOG_PID")
        .env_remove("LISTEN_FDS")
        .env_remove("LISTEN_PID")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let mut child = match begun {
        Ok(child) => child,
        Err(error) => return Ended::Unclear(format!("there is no process for it: {error}")),
    };
    let (input, output) = (child.stdin.take(), child.stdout.take());
    let (end, peak_mb, at) = thread::scope(|scope| {
        scope.spawn(move || {
            // A child that ended before it read everything is judged by its end.
            let _ = input
                .map(|input| postcard::to_io(case, BufWriter::new(input)).map(|mut input| input.flush()));
        });
        let places = scope.spawn(move || last_place(output));
        let (end, peak_mb) = watch(&mut child, beat, is_over);
        (end, peak_mb, places.join().ok().flatten())
    });
    match end {
        Ok(status) => judged(status, peak_mb, at),
        Err(Stopping::Asked) => Ended::Stopped,
        Err(Stopping::Late) => Ended::Late,
    }
}

/// Reason why a child was ended by its parent.
enum Stopping {
    Asked,
    Late,
}

/// Waits for the end of a child; also returns the most memory it was seen with \[MB\].
fn watch(
    child: &mut Child,
    beat: Option<&Beat>,
    is_over: &AtomicBool,
) -> (Result<ExitStatus, Stopping>, f64) {
    let begun = Instant::now();
    let mut peak_mb: f64 = 0.0;
    let stopping = loop {
        if let Ok(Some(status)) = child.try_wait() {
            return (Ok(status), peak_mb);
        }
        beat.into_iter().for_each(Beat::pass);
        peak_mb = peak_mb.max(process::peak_mb(child.id()));
        if is_over.load(Ordering::Relaxed) {
            break Stopping::Asked;
        }
        if begun.elapsed() > PATIENCE {
            break Stopping::Late;
        }
        thread::sleep(LOOK);
    };
    // It may have ended meanwhile.
    let _ = child.kill();
    let _ = child.wait();
    (Err(stopping), peak_mb)
}

fn judged(status: ExitStatus, peak_mb: f64, at: Option<Place>) -> Ended {
    if status.success() {
        return Ended::Well;
    }
    let own = |signal: i32| OWN_DOING.iter().find(|(number, _)| *number == signal);
    match (status.signal(), status.code()) {
        (Some(SIGKILL), _) if peak_mb >= MOST_MB => Ended::Died {
            how: format!("was killed by the system when it had {peak_mb:.0} MB"),
            at,
        },
        (Some(signal), _) => match own(signal) {
            Some((_, name)) => Ended::Died {
                how: format!("ended by {name}, with {peak_mb:.0} MB"),
                at,
            },
            None => Ended::Unclear(format!("signal {signal} from outside ended it")),
        },
        (None, Some(PANIC)) => Ended::Died {
            how: "panicked".to_owned(),
            at,
        },
        (None, code) => Ended::Unclear(format!("it could not begin: exit code {}", code.unwrap_or(-1))),
    }
}

/// The last place that a child told before it ended.
fn last_place(output: Option<impl Read>) -> Option<Place> {
    let mut output = output?;
    let (mut place, mut last) = ([0; Place::BYTES], None);
    while output.read_exact(&mut place).is_ok() {
        last = Some(Place::of_bytes(place));
    }
    last
}
