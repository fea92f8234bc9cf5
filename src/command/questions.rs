//! Questions to a person at a terminal: repeated with the reason until the answer is valid, and confirmed.

use super::BadArguments;
use std::io::{self, BufRead, IsTerminal, Read, StdinLock, Write};

/// Longest answer read \[bytes\].
const LONGEST: u64 = 4096;

/// Source of answers for missing flags.
pub struct Questions<R> {
    /// Input of the answers.
    pub answers: R,
    /// True if a person can answer.
    pub is_terminal: bool,
}

impl Questions<StdinLock<'static>> {
    /// Asks on this terminal, if there is one.
    pub fn here() -> Self {
        Self {
            answers: io::stdin().lock(),
            is_terminal: io::stdin().is_terminal() && io::stderr().is_terminal(),
        }
    }
}

impl<R: BufRead> Questions<R> {
    /// Asks a question; without a terminal, or at the end of the answers, an error names the flag.
    pub fn ask<T>(
        &mut self,
        question: &str,
        flag: &str,
        understand: impl Fn(&str) -> Result<T, String>,
    ) -> anyhow::Result<T> {
        if !self.is_terminal {
            return Err(BadArguments(format!("{flag} is needed ({question})")).into());
        }
        loop {
            let Some(answer) = self.line(question)? else {
                return Err(BadArguments(format!("no answer: {flag} is needed ({question})")).into());
            };
            match understand(&answer) {
                Ok(answer) => return Ok(answer),
                Err(why) => tell!("  {why}"),
            }
        }
    }

    /// Asks an optional question; `None` without a terminal, for an empty answer, or at the end of the
    /// answers.
    pub fn ask_open<T>(
        &mut self,
        question: &str,
        understand: impl Fn(&str) -> Result<T, String>,
    ) -> anyhow::Result<Option<T>> {
        while self.is_terminal {
            match self.line(question)?.as_deref() {
                None | Some("") => break,
                Some(answer) => match understand(answer) {
                    Ok(answer) => return Ok(Some(answer)),
                    Err(why) => tell!("  {why}"),
                },
            }
        }
        Ok(None)
    }

    /// Confirms the value understood.
    pub fn confirm(&self, understood: &str) {
        if self.is_terminal {
            tell!("  = {understood}");
        }
    }

    /// Reads one answer, trimmed; `None` at their end.
    fn line(&mut self, question: &str) -> io::Result<Option<String>> {
        let mut err = io::stderr();
        write!(err, "{question}: ").and_then(|()| err.flush())?;
        let mut answer = String::new();
        let read = self.answers.by_ref().take(LONGEST).read_line(&mut answer)?;
        Ok((read > 0).then(|| answer.trim().to_owned()))
    }
}
