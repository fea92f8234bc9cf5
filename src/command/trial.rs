//! `tirante trial FORMAT LEVEL`: the process of its own in which the daemon tries a step that it may have died of.
//!
//! It is no command of the program: no help, completion or man page names it.

use crate::service::daemon::trial::apart;
use crate::service::telemetry::log::Form;
use std::ffi::OsString;
use std::process::ExitCode;

/// Takes the step that the daemon hands over on standard input, if these words are the daemon's; the log is like the daemon's.
pub fn asked(words: impl Iterator<Item = OsString>) -> Option<ExitCode> {
    let words: Vec<OsString> = words.skip(1).collect();
    let [name, format, filter] = &words[..] else {
        return None;
    };
    if name != "trial" {
        return None;
    }
    let form = Form::of_words(format.to_str()?, filter.to_str()?)?;
    form.start();
    Some(match apart::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::warn!("a step cannot be tried: {error:#}");
            ExitCode::FAILURE
        }
    })
}
