//! Certificates of the clients that connected: one that stays connected for months shows its own once, and its end is told all the same.

use super::certificate::Validity;
use crate::service::telemetry::{Fault, Health};
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Time after the end of its certificate from which on a client counts as retired \[s\].
const RETIRED_S: i64 = 30 * 86_400;
/// Most clients remembered.
const MOST: usize = 1024;

/// Validity of the certificate that each client showed last.
#[derive(Debug, Default)]
pub(super) struct Clients(Mutex<BTreeMap<String, Validity>>);

impl Clients {
    /// Takes the certificate of a client that connects, whose near end is told.
    pub fn connected(&self, about: &str, valid: Validity, now_s: i64, health: &Health) {
        warn_of(about, valid, now_s, health);
        let mut clients = self.lock();
        if clients.len() < MOST || clients.contains_key(about) {
            clients.insert(about.to_owned(), valid);
        }
    }

    /// Tells which certificates have come near their end; called from time to time.
    pub fn look(&self, now_s: i64, health: &Health) {
        self.lock().retain(|about, valid| {
            let is_retired = now_s.saturating_sub(valid.ends_s) > RETIRED_S;
            match is_retired {
                true => health.over(Fault::Certificate, about),
                false => warn_of(about, *valid, now_s, health),
            }
            !is_retired
        });
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Validity>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn warn_of(about: &str, valid: Validity, now_s: i64, health: &Health) {
    let is_refused = match valid.holds(now_s) {
        true => "it is refused from then on",
        false => "it is refused",
    };
    match valid.warning(now_s) {
        Some(warning) => health.hold(
            Fault::Certificate,
            about,
            format_args!("the certificate of {about} {warning}; {is_refused}"),
        ),
        None => health.over(Fault::Certificate, about),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_certificate_is_told_while_its_client_stays_connected() {
        let (clients, health) = (Clients::default(), Health::default());
        let at = |day: i64| 1_800_000_000 + 86_400 * day;
        let valid = Validity {
            begins_s: at(0),
            ends_s: at(100),
        };
        clients.connected("client nave", valid, at(1), &health);
        clients.look(at(60), &health);
        assert!(health.conditions().is_empty());
        clients.look(at(80), &health);
        let detail = health.conditions()[0].detail.clone();
        assert!(
            detail.contains("client nave ends on") && detail.contains("in 20 days"),
            "{detail}"
        );
        clients.look(at(110), &health);
        let detail = health.conditions()[0].detail.clone();
        assert!(
            detail.contains("ended on") && detail.ends_with("it is refused"),
            "{detail}"
        );
        // It comes with a new one.
        let renewed = Validity {
            ends_s: at(400),
            ..valid
        };
        clients.connected("client nave", renewed, at(111), &health);
        assert!(health.conditions().is_empty());
        // It never comes again.
        clients.look(at(399), &health);
        assert_eq!(health.conditions().len(), 1);
        clients.look(at(431), &health);
        assert!(health.conditions().is_empty());
    }
}
