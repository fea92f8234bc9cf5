//! The child of a trial, as its parent sees it: started, watched, and judged by the way it ends.

use crate::service::daemon::places::Place;
use crate::service::telemetry::{Beat, log, process};
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
/// Memory from which on a killed child died of its own size, if the step took half of it or more: no input may need as much
/// \[MB\].
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
        at: Place,
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
    until: Instant,
    (beat, is_over): (&Beat, &AtomicBool),
) -> Ended {
    let begun = Command::new(program)
        .arg0("tirante")
        .arg("trial")
        // Its lines stand among the daemon's.
        .args(log::form().words())
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
    let pid = child.id();
    let (end, peak_mb, reached) = thread::scope(|scope| {
        scope.spawn(move || {
            // A child that ended before it read everything is judged by its end.
            let _ = input
                .map(|input| postcard::to_io(case, BufWriter::new(input)).map(|mut input| input.flush()));
        });
        let places = scope.spawn(move || Reached::by(output, pid));
        let (end, peak_mb) = watch(&mut child, until, beat, is_over);
        (end, peak_mb, places.join().ok().flatten())
    });
    match end {
        Ok(status) => judged(status, peak_mb, reached),
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
    until: Instant,
    beat: &Beat,
    is_over: &AtomicBool,
) -> (Result<ExitStatus, Stopping>, f64) {
    let mut peak_mb: f64 = 0.0;
    let stopping = loop {
        if let Ok(Some(status)) = child.try_wait() {
            return (Ok(status), peak_mb);
        }
        beat.pass();
        peak_mb = peak_mb.max(process::peak_mb(child.id()));
        if is_over.load(Ordering::Relaxed) {
            break Stopping::Asked;
        }
        if Instant::now() > until {
            break Stopping::Late;
        }
        thread::sleep(LOOK);
    };
    // It may have ended meanwhile.
    let _ = child.kill();
    let _ = child.wait();
    (Err(stopping), peak_mb)
}

fn judged(status: ExitStatus, peak_mb: f64, reached: Option<Reached>) -> Ended {
    if status.success() {
        return Ended::Well;
    }
    let own = |signal: i32| OWN_DOING.iter().find(|(number, _)| *number == signal);
    let how = match (status.signal(), status.code()) {
        (Some(SIGKILL), _) if peak_mb >= MOST_MB => {
            format!("was killed by the system when it had {peak_mb:.0} MB")
        }
        (Some(signal), _) => match own(signal) {
            Some((_, name)) => format!("ended by {name}, with {peak_mb:.0} MB"),
            None => return Ended::Unclear(format!("signal {signal} from outside ended it")),
        },
        (None, Some(PANIC)) => "panicked".to_owned(),
        (None, code) => {
            return Ended::Unclear(format!("it could not begin: exit code {}", code.unwrap_or(-1)));
        }
    };
    match reached {
        None => Ended::Unclear(format!("it {how} before it reached the step")),
        Some(reached) if status.signal() == Some(SIGKILL) && peak_mb - reached.with_mb < MOST_MB / 2.0 => {
            Ended::Unclear(format!(
                "it {how}, {:.0} MB before it reached the step",
                reached.with_mb
            ))
        }
        Some(Reached { at, .. }) => Ended::Died { how, at },
    }
}

/// The step as a child reached it.
struct Reached {
    /// The last place that it told before it ended.
    at: Place,
    /// The most memory it had when it told the first \[MB\].
    with_mb: f64,
}

impl Reached {
    /// Listens to a child until it ends; `None` if it told no place.
    fn by(output: Option<impl Read>, pid: u32) -> Option<Self> {
        let mut output = output?;
        let mut place = [0; Place::BYTES];
        output.read_exact(&mut place).ok()?;
        let with_mb = process::peak_mb(pid);
        let mut at = Place::of_bytes(place);
        while output.read_exact(&mut place).is_ok() {
            at = Place::of_bytes(place);
        }
        Some(Self { at, with_mb })
    }
}
