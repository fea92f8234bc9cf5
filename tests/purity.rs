//! The wall around the pure part: the numerics may not wait, read, remember or ask the machine.

use std::fs;
use std::path::{Path, PathBuf};

const PURE: [&str; 17] = [
    "record",
    "spectrum",
    "modes",
    "beam",
    "forward.rs",
    "emulator",
    "bayes",
    "analysis.rs",
    "ordered.rs",
    "outcome.rs",
    "findings.rs",
    "snapshot.rs",
    "study",
    "synthesis",
    "track",
    "random.rs",
    "wide.rs",
];

const FORBIDDEN: [&str; 22] = [
    "tokio",
    "std::fs",
    "std::env",
    "std::io",
    "std::net",
    "std::process",
    "std::thread",
    "SystemTime",
    "Instant",
    "Zoned::now",
    "Timestamp::now",
    "rand::rng()",
    "thread_rng",
    "SysRng",
    "println!",
    "eprintln!",
    "crate::config",
    "crate::source",
    "crate::sink",
    "crate::command",
    "crate::store",
    "crate::plot",
];

fn rust_files(path: &Path, found: &mut Vec<PathBuf>) {
    if path.is_dir() {
        for entry in fs::read_dir(path).expect("a folder of src").flatten() {
            rust_files(&entry.path(), found);
        }
    } else if path.extension().is_some_and(|e| e == "rs") {
        found.push(path.to_owned());
    }
}

/// The part of a file that ships: everything before its test module, comments removed.
fn shipped_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .take_while(|(_, line)| !line.starts_with("#[cfg(test)]"))
        .map(|(number, line)| (number + 1, line.split("//").next().unwrap_or("")))
}

#[test]
fn pure_modules_know_no_file_clock_generator_or_shell() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    for name in PURE {
        let path = source.join(name);
        assert!(path.exists(), "src/{name} is listed as pure but does not exist");
        rust_files(&path, &mut files);
    }
    assert!(files.len() > 20, "only {} pure files found", files.len());

    let mut offences = Vec::new();
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        for (number, line) in shipped_lines(&text) {
            for word in FORBIDDEN {
                if line.contains(word) {
                    offences.push(format!("{}:{number}: {word}", file.display()));
                }
            }
        }
    }
    assert!(
        offences.is_empty(),
        "pure code reaches outside:\n{}",
        offences.join("\n")
    );
}
