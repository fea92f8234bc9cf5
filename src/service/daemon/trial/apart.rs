//! The child of a trial: takes one step as the daemon would, and ends.

use super::{Case, Input, Reading, Step};
use crate::analysis::signal::record::{Event, RodChannels, SavedEvent};
use crate::config::Config;
use crate::recording::read::{self, Recording, Source};
use crate::service::daemon::places::{Place, Steps};
use crate::service::daemon::remembered::Remembered;
use crate::service::telemetry::process;
use crate::site::analyse::{self, Known};
use crate::site::{prepared, store};
use anyhow::Context;
use rustix::fs::{Mode, OFlags};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, IsTerminal, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::parent_id;
use std::path::Path;
use std::thread;
use std::time::Duration;

/// Address space that a daemon may take between a trial and the step: plans of transforms, stacks of threads \[bytes\].
const GROWTH: usize = 16 << 20;

/// Takes the step that standard input describes. The places of a file that is read go to standard output.
///
/// # Errors
/// It cannot begin: that says nothing of the step.
pub fn run() -> anyhow::Result<()> {
    anyhow::ensure!(!io::stdin().is_terminal(), "a trial is begun by the daemon only");
    // Where memory runs out this process goes first, not the daemon. Without the right to say so, the system chooses.
    let _ = fs::write("/proc/self/oom_score_adj", "1000");
    leave_with_the_daemon()?;
    let mut bytes = Vec::new();
    io::stdin().lock().read_to_end(&mut bytes)?;
    let case: Case<SavedEvent> =
        postcard::from_bytes(&bytes).context("a trial is begun by the daemon only")?;
    drop(bytes);
    let config = Config::parse(&case.config, "the daemon's configuration")?;
    match case.step {
        Step::Analysis(event) => analyse(event.0, config, case.address_space),
        Step::Reading(reading) => read(&reading, &config, &case.store, case.address_space),
    }
}

/// Ends this process when its parent is gone.
fn leave_with_the_daemon() -> io::Result<()> {
    let daemon = parent_id();
    let watch = move || {
        while parent_id() == daemon {
            thread::sleep(Duration::from_millis(100));
        }
        std::process::exit(1);
    };
    thread::Builder::new().spawn(watch).map(drop)
}

/// Takes as much address space as the daemon has, and what that may still take before it comes to the step: the system's
/// limit then leaves the same room. Without room for both the first alone.
fn ballast(daemon: u64) -> anyhow::Result<Vec<u8>> {
    let own = process::address_space().unwrap_or(daemon);
    let size = usize::try_from(daemon.saturating_sub(own))?;
    let mut ballast = Vec::new();
    // Reserved and never touched, it takes no memory.
    if daemon == 0 || ballast.try_reserve_exact(size + GROWTH).is_err() {
        ballast.try_reserve_exact(size).context("no address space")?;
    }
    // Nobody uses it, and it must be there.
    Ok(std::hint::black_box(ballast))
}

fn analyse(event: Event, mut config: Config, address_space: u64) -> anyhow::Result<()> {
    let rod = event.rod().clone();
    config.rods.retain(|other| other.analysis.rod == rod);
    let plans = prepared::plans(&config, |_| |_, _| ())?;
    plans.get(&rod).context("no such rod")?.table();
    let ballast = ballast(address_space)?;
    at_the_step(Place::default());
    std::hint::black_box(analyse::analyse(event, &plans, &Known::new()));
    drop(ballast);
    Ok(())
}

fn read(reading: &Reading, config: &Config, store: &Path, address_space: u64) -> anyhow::Result<()> {
    let channels: Vec<RodChannels> = config.rods.iter().map(|rod| rod.channels.clone()).collect();
    match &reading.input {
        Input::File { path, is_live } => {
            let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
            let path = Path::new(OsStr::from_bytes(path));
            let file = File::from(rustix::fs::open(path, flags, Mode::empty())?);
            let ballast = ballast(address_space)?;
            let recording = Recording::begin(&reading.name, file, &channels, &config.record, *is_live)?;
            pass(recording, reading);
            drop(ballast);
        }
        Input::Journal { folder } => {
            let remembered = Remembered::of(&store::Reader::open(store)?)?;
            let ballast = ballast(address_space)?;
            let resumed = remembered.journal(folder, &channels, &config.record);
            pass(resumed.series, reading);
            drop(ballast);
        }
    }
    Ok(())
}

/// Tells the daemon that the step at a place is begun: what happens before blames nothing.
fn at_the_step(place: Place) {
    let mut output = io::stdout().lock();
    // A parent that does not listen has ended.
    let _ = output.write_all(&place.to_bytes()).and_then(|()| output.flush());
}

/// Reads past the places, or ends the file at the first of them and takes what came before.
fn pass<S: Source>(mut source: S, reading: &Reading) {
    let mut left = reading.places.clone();
    let mut steps = Steps::default();
    let mut has_ended = false;
    loop {
        let here = source
            .position()
            .filter(|(name, _)| **name == *reading.name)
            .map(|(_, offset)| steps.next(offset));
        if let Some(here) = here.filter(|_| !has_ended) {
            at_the_step(here);
            if reading.ends_there && left.contains(&here) {
                source.abandon("tried apart");
                has_ended = true;
            }
        }
        match source.poll() {
            read::Step::Wait | read::Step::End => return,
            read::Step::File(_) if here.is_some() => return,
            read::Step::File(_) => {}
            read::Step::More | read::Step::Event(..) => steps.brought_something(),
        }
        if let Some(here) = here
            && !reading.ends_there
        {
            left.retain(|place| *place != here);
            if left.is_empty() {
                return;
            }
        }
    }
}
