//! Places of each certificate's holder: no single one takes all.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Places of the holders of certificates.
#[derive(Debug)]
pub(super) struct Shares {
    most: usize,
    holders: Arc<Mutex<HashMap<String, usize>>>,
}

/// A place of a holder, until dropped.
#[derive(Debug)]
pub(super) struct Share {
    holder: Option<String>,
    holders: Arc<Mutex<HashMap<String, usize>>>,
}

impl Shares {
    /// Shares of this many places: three quarters of them at most for one holder.
    pub fn of(places: usize) -> Self {
        Self {
            most: (places - places / 4).max(1),
            holders: Arc::default(),
        }
    }

    /// Most places of one holder.
    pub fn most(&self) -> usize {
        self.most
    }

    /// A place for a holder; `None` if it has the most. Clients without a certificate are not counted: they come from this machine.
    pub fn enter(&self, holder: Option<&str>) -> Option<Share> {
        if let Some(holder) = holder {
            let mut holders = lock(&self.holders);
            let places = holders.entry(holder.to_owned()).or_default();
            if *places >= self.most {
                return None;
            }
            *places += 1;
        }
        Some(Share {
            holder: holder.map(str::to_owned),
            holders: Arc::clone(&self.holders),
        })
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let Some(holder) = &self.holder else { return };
        let mut holders = lock(&self.holders);
        if let Some(places) = holders.get_mut(holder) {
            *places -= 1;
            if *places == 0 {
                holders.remove(holder);
            }
        }
    }
}

fn lock(holders: &Mutex<HashMap<String, usize>>) -> MutexGuard<'_, HashMap<String, usize>> {
    holders.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_holder_has_three_quarters_at_most_and_others_the_rest() {
        let shares = Shares::of(8);
        let mut of_alice: Vec<_> = (0..6).map(|_| shares.enter(Some("alice")).unwrap()).collect();
        assert!(shares.enter(Some("alice")).is_none());
        assert!(shares.enter(Some("bob")).is_some());
        assert!((0..100).all(|_| shares.enter(None).is_some()));
        of_alice.pop();
        assert!(shares.enter(Some("alice")).is_some());
        drop(of_alice);
        assert!(lock(&shares.holders).is_empty());
        assert!(Shares::of(1).enter(Some("alice")).is_some());
    }
}
