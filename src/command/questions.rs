//! Questions to a person at a terminal: asked again with the reason until the answer is understood, and confirmed.

use super::BadArguments;
use std::io::{self, BufRead, IsTerminal, Read, StdinLock, Write};

/// The longest answer read \[bytes\].
const LONGEST: u64 = 4096;

/// Answers to what no flag says.
pub struct Questions<R> {
    /// Where answers come from.
    pub answers: R,
    /// Whether somebody is there to answer.
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
    /// The answer to a question; without a terminal, or at the end of the answers, an error that names the flag.
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

    /// The answer to a question that may be left open; nothing without a terminal, for an empty answer, or at their end.
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

    /// Says to who answers what was understood.
    pub fn confirm(&self, understood: &str) {
        if self.is_terminal {
            tell!("  = {understood}");
        }
    }

    /// One answer, trimmed; nothing at their end.
    fn line(&mut self, question: &str) -> io::Result<Option<String>> {
        let mut err = io::stderr();
        write!(err, "{question}: ").and_then(|()| err.flush())?;
        let mut answer = String::new();
        let read = self.answers.by_ref().take(LONGEST).read_line(&mut answer)?;
        Ok((read > 0).then(|| answer.trim().to_owned()))
    }
}
