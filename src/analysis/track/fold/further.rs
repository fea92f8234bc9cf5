//! A further loss under a `limit` that stands, where no change at the reference temperature tells it: told anew.
//!
//! It shows twice. In all, the loss exceeds the one told by as much as a drift that is told anew; and the rod's own records, which have
//! learned the first one by now, show a loss that would be a `limit` by itself.
//!
//! Beyond the prepared range no record is learned: what a season adds to a loss there looks the same, and is told as out of range alone.

use super::growth::is_further;
use super::loss::Before;
use super::tracker::{LOSS_RECORDS, Tracker};
use crate::signal::record::Timestamp;
use crate::track::alarm::{Cause, Kind, Known, Standing};

/// Loss that a record shows, as a share of the force, beside the one that was told.
#[derive(Debug, Clone, Copy)]
pub(super) struct Further {
    /// In all, from the level before the first.
    pub total: f64,
    /// Its lower end.
    pub least: f64,
    /// True if it is certain by itself.
    pub is_certain: bool,
    /// True if no second record is needed.
    pub decides: bool,
}

impl Tracker {
    /// Checks a record for a further loss; `before`: the level before the first.
    pub(super) fn look_at_further_loss(&mut self, before: &mut Before, further: Further, time: Timestamp) {
        let told = *before.told.get_or_insert(further.total);
        let holds = further.is_certain && is_further(told, further.total - told);
        let mut standing = Standing::Undecided;
        for _ in 0..if further.decides && holds { LOSS_RECORDS } else { 1 } {
            standing = self.find(Cause::Further, Some(holds));
        }
        if standing == Standing::Holds {
            self.tell_further_loss(further.least, time);
            before.told = Some(further.total);
        }
    }

    /// Tells the `limit` anew.
    pub(super) fn tell_further_loss(&mut self, least: f64, time: Timestamp) {
        let limit = self.plan.alarm.limit_loss;
        let message = format!(
            "the axial force fell further since it was told, now by {:.0} % at least, above the limit of {:.1} %, faster and further than \
             any temperature moves it",
            100.0 * least,
            100.0 * limit
        );
        self.on_board(|board| board.tell_anew(Kind::Limit, time, message, Known::default()));
        self.state.watches.end(Cause::Further);
    }
}
