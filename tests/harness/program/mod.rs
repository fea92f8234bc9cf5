//! The program as users run it: a line of words in a folder, its exit code and what it printed.
#![allow(clippy::unwrap_used, dead_code)] // helpers of tests are tests; not every test uses all of them

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// The project's folder: the words of its documents hold there.
pub const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// The program in a folder, without answers to its questions.
pub fn program(folder: impl AsRef<Path>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tirante"));
    command
        .current_dir(folder)
        .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
        .env_remove("TIRANTE_LOG")
        .stdin(Stdio::null());
    command
}

/// Runs the words of a line; between single quotes a blank belongs to the word.
pub fn tirante(folder: impl AsRef<Path>, line: &str) -> Said {
    Said::of(line, program(folder).args(words(line)))
}

pub fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split('\'').enumerate().flat_map(|(i, part)| match i % 2 {
        0 => part.split_whitespace().collect(),
        _ => vec![part],
    })
}

/// End of the program.
#[derive(Debug)]
pub struct Said {
    line: String,
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

impl Said {
    pub fn of(line: &str, command: &mut Command) -> Self {
        let Output {
            status,
            stdout,
            stderr,
        } = command.output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Self {
            line: line.to_owned(),
            code: status.code(),
            out: text(stdout),
            err: text(stderr),
        }
    }

    /// The same, with the exit code checked.
    #[track_caller]
    pub fn ends(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{}: {}", self.line, self.all());
        self
    }

    /// Standard output of a program that ended well.
    #[track_caller]
    pub fn done(self) -> String {
        self.ends(0).out
    }

    /// The JSON lines of its standard output.
    pub fn lines(&self) -> Vec<Value> {
        self.out
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }

    /// The JSON line of a program that ended well and printed one.
    #[track_caller]
    pub fn only(self) -> Value {
        serde_json::from_str(&self.done()).unwrap()
    }

    /// Checks that its messages hold every part.
    #[track_caller]
    pub fn says(self, parts: &[&str]) -> Self {
        for part in parts {
            assert!(
                self.err.contains(part),
                "{}: no {part} in {}",
                self.line,
                self.err
            );
        }
        self
    }

    /// Everything printed.
    pub fn all(&self) -> String {
        self.out.clone() + &self.err
    }
}
