//! The file of slots: the step at which each thread is at work, kept by the system through any end of the process.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Size of a slot \[bytes\].
pub(super) const SLOT: usize = 1024;
/// Most slots: more than any machine has workers. The first names the boot of the machine.
const MOST_SLOTS: usize = 1100;
/// Kind of the first slot.
const BOOT: &str = "boot";
const ALONE: &str = "alone";
const BESIDE: &str = "beside";

/// Steps that were at work when a process ended.
#[derive(Debug, Default)]
pub(super) struct Left {
    boot: Option<String>,
    /// Steps, each with true if nothing else was at work.
    pub(super) steps: Vec<(String, bool)>,
}

impl Left {
    /// Reads a file of slots; one that is missing names no step.
    pub(super) fn read(path: &Path) -> io::Result<Self> {
        match fs::read(path) {
            Ok(bytes) => Ok(Self::of(&bytes)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(error),
        }
    }

    fn of(bytes: &[u8]) -> Self {
        let mut left = Self::default();
        for slot in bytes.chunks(SLOT).take(MOST_SLOTS) {
            let end = slot.iter().position(|byte| *byte == 0).unwrap_or(slot.len());
            let text = String::from_utf8_lossy(&slot[..end]);
            match text.split_once('\t') {
                None => {}
                Some((BOOT, boot)) => left.boot = Some(boot.to_owned()),
                Some((kind, name)) => left.steps.push((name.to_owned(), kind == ALONE)),
            }
        }
        left
    }

    /// True if the machine was booted since; false where boots have no name.
    pub(super) fn went_with_the_machine(&self) -> bool {
        let boot = boot();
        self.boot.is_some() && boot.is_some() && self.boot != boot
    }
}

/// The file of slots of this process.
#[derive(Debug)]
pub(super) struct Slots(File);

impl Slots {
    /// Begins the file anew.
    pub(super) fn begin(path: &Path) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        let file = options.write(true).create(true).truncate(true).open(path)?;
        if let Some(boot) = boot() {
            let _ = file.write_all_at(&content(BOOT, &boot), 0);
        }
        Ok(Self(file))
    }

    /// Writes a step into a slot, or clears it; best effort: without it a crash is not counted.
    pub(super) fn mark(&self, slot: usize, step: Option<(&str, bool)>) {
        let content = step.map_or([0; SLOT], |(name, is_alone)| {
            content(if is_alone { ALONE } else { BESIDE }, name)
        });
        if slot < MOST_SLOTS {
            let _ = self.0.write_all_at(&content, (slot * SLOT) as u64);
        }
    }

    /// Clears all slots, best effort: at worst a step is taken alone.
    pub(super) fn clear(&self) {
        let _ = self.0.set_len(0);
    }
}

/// Content of a slot. The excess is cut off: the name alone distinguishes steps.
fn content(kind: &str, name: &str) -> [u8; SLOT] {
    let mut content = [0; SLOT];
    let mut rest = &mut content[..];
    let _ = write!(rest, "{kind}\t{name}");
    content
}

/// Identity of the machine's present boot: the unit names it, since its sandbox hides the file.
fn boot() -> Option<String> {
    let named = std::env::var("TIRANTE_BOOT_ID").ok().filter(|id| !id.is_empty());
    let id = named.or_else(|| fs::read_to_string("/proc/sys/kernel/random/boot_id").ok())?;
    let id: String = id.chars().filter(char::is_ascii_hexdigit).collect();
    Some(id).filter(|id| !id.is_empty())
}

/// Puts another boot into a file of slots.
#[cfg(test)]
pub(super) fn boot_anew(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    bytes[..SLOT].copy_from_slice(&content(BOOT, "another"));
    fs::write(path, bytes).unwrap();
}
