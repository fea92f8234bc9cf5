//! The log as a sink: one line per message; it always exists.

use super::{Failure, Message, Sink};

/// The program's log.
pub(super) struct Log;

impl Sink for Log {
    fn deliver(&mut self, message: &Message) -> Result<(), Failure> {
        tracing::warn!(
            alarm = message.alarm,
            rod = message.rod,
            kind = message.kind,
            what = message.what.code(),
            id = message.id,
            "{}: {}",
            message.subject(),
            message.message
        );
        Ok(())
    }
}
