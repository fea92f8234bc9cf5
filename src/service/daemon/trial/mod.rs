//! A step tried in a process of its own: what dies there, while the daemon lives to see it, is set aside.
//!
//! A daemon that ended while it took a step may have died of it, or been killed from outside: by `kill -9`, a power cut, or
//! for memory that another program took. Only the system knows which, and it tells nobody but a parent. So the step is taken
//! once more by a child (`tirante trial`, [`apart`]) with the same input, the same configuration and the same room in memory,
//! and how that child ends is the verdict. It is the first that the system ends when memory runs out.

pub mod apart;
mod child;

use self::child::Ended;
use super::places::Place;
use crate::analysis::signal::record::{Event, EventToSave};
use crate::service::telemetry::Beat;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Number of children that must die of a step before it is set aside.
pub const DEATHS: u32 = 2;
/// Most children for one verdict: one that is killed from outside says nothing.
const TRIES: u32 = 4;
/// Longest trial: nothing is learned after it. A step that would hang the daemon is ended by the watchdog, and counted.
const PATIENCE: Duration = Duration::from_mins(2);

/// A step to be tried, as the child gets it on its standard input: with an event to be written, or one that was read.
#[derive(Debug, Serialize, Deserialize)]
struct Case<E> {
    store: PathBuf,
    /// The configuration in force, with every default.
    config: String,
    /// Address space of the daemon where the system limits it, else 0 \[bytes\].
    address_space: u64,
    step: Step<E>,
}

#[derive(Debug, Serialize, Deserialize)]
enum Step<E> {
    Analysis(E),
    Reading(Reading),
}

/// Reading of a file, from its beginning past some places.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Reading {
    /// Name of the file in the store.
    name: String,
    input: Input,
    /// The places to pass.
    places: Vec<Place>,
    /// True if the file is to be ended at the first of them, and what was read before brought to its end.
    ends_there: bool,
}

/// A source to read.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Input {
    /// One recording.
    File {
        /// Its path, as the system's bytes.
        path: Vec<u8>,
        /// True if it may still grow.
        is_live: bool,
    },
    /// The journal, from where the store's marks end.
    Journal {
        /// Its folder.
        folder: PathBuf,
    },
}

/// Result of a trial.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// The step was taken, or nothing could be learned.
    Cleared,
    /// Children died of it.
    Died {
        /// Manner of the last death.
        how: String,
        /// Place of the file where it was.
        at: Place,
    },
    /// The daemon stops.
    Stopped,
}

/// Means of a daemon to try steps.
#[derive(Debug)]
pub struct Trials {
    /// The program itself; without it nothing is tried.
    program: Option<PathBuf>,
    store: PathBuf,
    config: Mutex<String>,
    beat: Arc<Beat>,
    is_over: AtomicBool,
}

impl Trials {
    /// Trials by this program, beside this store; `beat` passes while the reader waits for one.
    pub fn new(program: Option<PathBuf>, store: PathBuf, config: String, beat: Arc<Beat>) -> Self {
        Self {
            program,
            store,
            config: Mutex::new(config),
            beat,
            is_over: AtomicBool::new(false),
        }
    }

    /// Takes another configuration, with every default.
    pub fn configure(&self, config: String) {
        *self.config.lock().unwrap_or_else(PoisonError::into_inner) = config;
    }

    /// Ends the trial under way and begins no other.
    pub fn stop(&self) {
        self.is_over.store(true, Ordering::Relaxed);
    }

    /// Tries the analysis of a record or a moment.
    pub fn of_analysis(&self, what: &str, event: &Event) -> Verdict {
        self.try_apart(what, Step::Analysis(EventToSave(event)))
    }

    /// Tries to read a file past these places; with `ends_there`, up to the first of them, and to bring what came before to its end.
    pub fn of_reading(&self, name: &str, input: &Input, places: &[Place], ends_there: bool) -> Verdict {
        let reading = Reading {
            name: name.to_owned(),
            input: input.clone(),
            places: places.to_vec(),
            ends_there,
        };
        self.try_apart(name, Step::Reading(reading))
    }

    fn try_apart(&self, what: &str, step: Step<EventToSave<'_>>) -> Verdict {
        let Some(program) = &self.program else {
            return Verdict::Cleared;
        };
        let config = self.config.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let case = Case {
            store: self.store.clone(),
            config,
            address_space: child::limited_space(),
            step,
        };
        tracing::info!("{what}: the program ended twice at this step; it is tried in a process of its own");
        let until = Instant::now() + PATIENCE;
        let mut deaths = 0;
        for _ in 0..TRIES {
            match child::run(program, &case, until, (&self.beat, &self.is_over)) {
                Ended::Well => {
                    tracing::info!("{what}: a process of its own took that step; nothing is set aside");
                    return Verdict::Cleared;
                }
                Ended::Stopped => return Verdict::Stopped,
                Ended::Late => {
                    tracing::warn!("{what}: tried apart, nothing was learned in time");
                    return Verdict::Cleared;
                }
                Ended::Unclear(why) => tracing::warn!("{what}: tried apart, nothing was learned: {why}"),
                Ended::Died { how, at } => {
                    deaths += 1;
                    tracing::warn!("{what}: a process of its own {how}");
                    if deaths >= DEATHS {
                        return Verdict::Died { how, at };
                    }
                }
            }
        }
        Verdict::Cleared
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::PermissionsExt;
    use std::path::Path;
    use std::time::{Duration, Instant};

    fn trials(folder: &Path, script: &str) -> Trials {
        let program = folder.join("program");
        fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        Trials::new(
            Some(program),
            folder.join("site.db"),
            String::new(),
            Arc::default(),
        )
    }

    /// Tells the place 0+0.
    const AT_THE_STEP: &str = "head -c 16 /dev/zero";

    /// Becomes a program that reads more into memory than any step may need and then waits for a reader of all of it, while `then` runs
    /// beside it.
    fn holding_much(folder: &Path, then: &str) -> String {
        let pipe = folder.join("pipe");
        format!(
            "mkfifo {0}.$$; exec 3<>{0}.$$; (head -c 1 <&3 >/dev/null; {then}) & exec dd if=/dev/zero bs=300000000 count=1 >&3",
            pipe.display()
        )
    }

    fn verdict(trials: &Trials) -> Verdict {
        let input = Input::Journal {
            folder: PathBuf::new(),
        };
        trials.of_reading("a.mcap", &input, &[], false)
    }

    #[test]
    fn the_way_a_child_ends_is_the_verdict() {
        let folder = tempfile::tempdir().unwrap();
        let of = |script: &str| verdict(&trials(folder.path(), &format!("{AT_THE_STEP}; {script}")));
        assert_eq!(of("exit 0"), Verdict::Cleared);
        for (script, how) in [
            ("kill -ABRT $$", "SIGABRT"),
            ("kill -SEGV $$", "SIGSEGV"),
            ("exit 101", "panicked"),
        ] {
            let verdict = of(script);
            assert!(
                matches!(&verdict, Verdict::Died { how: told, .. } if told.contains(how)),
                "{script}: {verdict:?}"
            );
        }
        // Killed from outside, or not able to begin: that says nothing of the step.
        for script in ["kill -KILL $$", "kill -TERM $$", "exit 1", "exit 2"] {
            assert_eq!(of(script), Verdict::Cleared, "{script}");
        }
        let missing = Trials::new(
            Some(folder.path().join("none")),
            PathBuf::new(),
            String::new(),
            Arc::default(),
        );
        assert_eq!(verdict(&missing), Verdict::Cleared);
    }

    #[test]
    fn a_child_that_did_not_reach_the_step_blames_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let of = |script: &str| verdict(&trials(folder.path(), script));
        let then = format!("{AT_THE_STEP}; sleep 1; kill -KILL $$");
        for script in ["kill -ABRT $$", "exit 101", &holding_much(folder.path(), &then)] {
            assert_eq!(of(script), Verdict::Cleared, "{script}");
        }
    }

    #[test]
    fn one_death_is_an_accident_and_the_place_is_the_last_one_told() {
        let folder = tempfile::tempdir().unwrap();
        let once = folder.path().join("once");
        let script = format!(
            "{AT_THE_STEP}; [ -e {0} ] && exit 0; touch {0}; kill -ABRT $$",
            once.display()
        );
        assert_eq!(verdict(&trials(folder.path(), &script)), Verdict::Cleared);
        // Two places of sixteen bytes and the beginning of a third.
        let place = |offset: u8| format!("\\{offset:o}\\0\\0\\0\\0\\0\\0\\0\\3\\0\\0\\0\\0\\0\\0\\0");
        let script = format!("printf '{}{}x'; kill -ABRT $$", place(1), place(2));
        let Verdict::Died { at, .. } = verdict(&trials(folder.path(), &script)) else {
            panic!("it died");
        };
        assert_eq!(at, Place { offset: 2, taken: 3 });
    }

    #[test]
    fn a_child_that_had_much_memory_when_it_was_killed_died_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let script = holding_much(folder.path(), "sleep 1; kill -KILL $$");
        let verdict = verdict(&trials(folder.path(), &format!("{AT_THE_STEP}; {script}")));
        assert!(
            matches!(&verdict, Verdict::Died { how, .. } if how.contains("MB")),
            "{verdict:?}"
        );
    }

    #[test]
    fn a_stop_ends_a_trial_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let trials = trials(folder.path(), "exec sleep 600");
        let begun = Instant::now();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(50));
                trials.stop();
            });
            assert_eq!(verdict(&trials), Verdict::Stopped);
        });
        assert!(begun.elapsed() < Duration::from_secs(60));
    }
}
