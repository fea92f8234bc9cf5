//! The list of suspects: how often the program ended at a step, and when that is too often.

use super::names::{begin_of_places, file_of, file_step};
use crate::recording::atomic::AtomicFile;
use crate::service::daemon::places::Place;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::Path;

/// Number of ends at a step, alone, after which it is not taken again, whatever a process of its own showed. With the first
/// end, which blames no step, these are five: systemd must not give up before (docs/daemon.md). One that came with an end of
/// the machine counts half: a power cut is nobody's fault, but a step that is there at each of so many takes the machine down.
pub const LAST: u32 = 4;

/// Most suspects remembered at which the program did not end alone.
const MOST: usize = 256;
/// Number of ends that stood for a condemned step in lists of earlier versions.
const CONDEMNED: u32 = 1000;

/// Ends of the program at a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Written")]
pub struct Ends {
    /// Number of ends with no other step at work; of a step that was condemned with those of the processes of its own.
    pub alone: u32,
    /// Number of those that came with an end of the machine.
    pub with_machine: u32,
    /// True if processes of its own died of it.
    pub is_condemned: bool,
}

/// Ends as lists have them: earlier versions wrote a number.
#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Number(u32),
    Ends {
        alone: u32,
        #[serde(default)]
        with_machine: u32,
        #[serde(default)]
        is_condemned: bool,
    },
}

impl From<Written> for Ends {
    fn from(written: Written) -> Self {
        match written {
            Written::Number(alone) => Self {
                alone,
                with_machine: 0,
                is_condemned: alone >= CONDEMNED,
            },
            Written::Ends {
                alone,
                with_machine,
                is_condemned,
            } => Self {
                alone,
                with_machine,
                is_condemned,
            },
        }
    }
}

impl Ends {
    /// True if a step with them is not to be taken again.
    pub fn is_too_many(&self) -> bool {
        self.exceed(0)
    }

    /// True if nothing of a file with them is to be used: those alone at one place, and one more while its data before that
    /// place was completed.
    pub fn is_too_many_for_a_file(&self) -> bool {
        self.exceed(1)
    }

    fn exceed(&self, more: u32) -> bool {
        let halves = (2 * self.alone).saturating_sub(self.with_machine);
        self.is_condemned || halves >= 2 * (LAST + more)
    }

    fn add(&mut self, with_machine: bool) {
        self.alone += 1;
        self.with_machine += u32::from(with_machine);
    }

    /// Takes back those of a step that went well after all.
    fn take_back(&mut self, cleared: Self) {
        self.alone = self.alone.saturating_sub(cleared.alone);
        self.with_machine = self.with_machine.saturating_sub(cleared.with_machine);
    }

    /// Reason why a step with them is set aside, as the end of a sentence.
    pub fn reason(&self) -> String {
        match (self.is_condemned, self.with_machine) {
            (true, _) => "ended the program and a process of its own".to_owned(),
            (false, 0) => format!("ended the program {} times", self.alone),
            (false, boots) => format!(
                "ended the program {} times, {boots} of them with the machine",
                self.alone
            ),
        }
    }
}

/// Suspect steps.
#[derive(Debug, Default)]
pub(super) struct Suspects(BTreeMap<String, Ends>);

impl Suspects {
    /// Reads a list; one that is missing, or not understood, is empty.
    pub(super) fn read(path: &Path) -> io::Result<Self> {
        match fs::read(path) {
            Ok(bytes) => Ok(Self(serde_json::from_slice(&bytes).unwrap_or_else(|error| {
                tracing::warn!("{}: not understood ({error}), begun anew", path.display());
                BTreeMap::new()
            }))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(error),
        }
    }

    /// Writes the list, best effort.
    pub(super) fn write(&self, path: &Path) {
        let write = || {
            let mut file = AtomicFile::create(path)?;
            serde_json::to_writer_pretty(&mut file, &self.0)?;
            file.write_all(b"\n")?;
            file.commit()
        };
        if let Err(error) = write() {
            tracing::warn!("{}: cannot be written: {error}", path.display());
        }
    }

    /// Suspects a step at which the program ended. Beside others it is not counted, and neither is a file, unless the step
    /// completed its data: that is taken for a place that was counted before.
    pub(super) fn suspect(&mut self, step: &str, is_alone: bool, with_machine: bool) {
        if let Some((file, is_last)) = file_of(step) {
            self.count(&file_step(file), is_alone || is_last, with_machine);
        }
        self.count(step, is_alone, with_machine);
    }

    fn count(&mut self, step: &str, is_counted: bool, with_machine: bool) {
        let ends = self.0.entry(step.to_owned()).or_default();
        if is_counted {
            ends.add(with_machine);
        }
    }

    /// Forgets uncounted suspects if there are too many.
    pub(super) fn shorten(&mut self) {
        if self.0.len() > MOST {
            self.0.retain(|_, ends| ends.alone > 0);
        }
    }

    /// Ends at a suspect step.
    pub(super) fn get(&self, step: &str) -> Option<Ends> {
        self.0.get(step).copied()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Clears a step, and its file of the ends at it; returns true if it was a suspect.
    pub(super) fn clear(&mut self, step: &str) -> bool {
        let Some(ends) = self.0.remove(step) else {
            return false;
        };
        if let Some((file, _)) = file_of(step)
            && let Some(of_file) = self.0.get_mut(&file_step(file))
        {
            of_file.take_back(ends);
        }
        true
    }

    /// Condemns a step of which so many processes of its own died.
    pub(super) fn condemn(&mut self, step: &str, deaths: u32) {
        let ends = self.0.entry(step.to_owned()).or_default();
        ends.alone += deaths;
        ends.is_condemned = true;
    }

    /// Places of a file at which the program ended with no other step at work.
    pub(super) fn places(&self, file: &str) -> Vec<(Place, Ends)> {
        let begin = begin_of_places(file);
        self.0
            .range(begin.clone()..)
            .take_while(|(name, _)| name.starts_with(&begin))
            .filter(|(_, ends)| ends.alone > 0)
            .filter_map(|(name, ends)| Some((Place::parse(&name[begin.len()..])?, *ends)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_with_the_machine_count_half() {
        let ends = |alone, with_machine| Ends {
            alone,
            with_machine,
            is_condemned: false,
        };
        for (alone, with_machine, is) in [
            (3, 0, false),
            (4, 0, true),
            (4, 1, false),
            (5, 1, true),
            (7, 7, false),
            (7, 4, true),
            (6, 5, false),
            (8, 8, true),
        ] {
            let ends = ends(alone, with_machine);
            assert_eq!(ends.is_too_many(), is, "{ends:?}");
        }
        assert!(!ends(4, 0).is_too_many_for_a_file() && ends(5, 0).is_too_many_for_a_file());
        assert!(ends(8, 8).reason().contains("8 of them with the machine"));
    }

    #[test]
    fn lists_of_earlier_versions_are_read() {
        let old: BTreeMap<String, Ends> = serde_json::from_str(r#"{"a": 2, "b": 1000}"#).unwrap();
        assert_eq!(old["a"].alone, 2);
        assert!(!old["a"].is_too_many() && old["b"].is_condemned);
        let text = serde_json::to_string(&old).unwrap();
        assert_eq!(
            serde_json::from_str::<BTreeMap<String, Ends>>(&text).unwrap(),
            old
        );
    }

    #[test]
    fn a_place_that_goes_well_clears_its_file_of_its_ends() {
        let mut suspects = Suspects::default();
        for place in 0..10 {
            // Killed twice at every place of a long file, each time once alone, and past it in the end.
            let step = format!("a.mcap@{place}+0");
            suspects.suspect(&step, false, false);
            suspects.suspect(&step, true, false);
            assert!(suspects.clear(&step));
        }
        let of_file = suspects.get(&file_step("a.mcap")).unwrap();
        assert_eq!(of_file, Ends::default());
    }
}
