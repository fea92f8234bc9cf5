//! Clients between their connection and their first valid data, TLS included: they take no client's place,
//! and of a crowd the oldest makes room for the newest.

use std::collections::{HashMap, VecDeque};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};

/// Most clients in the entrance of one listener.
const MOST: usize = 128;

/// Time of a client in a crowd for its handshake and first data; others wait meanwhile.
const STAY: Duration = Duration::from_millis(300);

/// The entrance of one listener.
#[derive(Default)]
pub(super) struct Entrance {
    waiting: Mutex<VecDeque<Waiting>>,
}

struct Waiting {
    address: Option<IpAddr>,
    since: Instant,
    leave: Arc<Notify>,
}

/// A client's stay in the entrance, until dropped.
pub(super) struct Stay {
    entrance: Arc<Entrance>,
    leave: Arc<Notify>,
}

impl Entrance {
    /// Admits a client of `address`, and turns another one out if full; waits while all came just now. Also
    /// returns true if one had to leave.
    pub async fn enter(self: &Arc<Self>, address: Option<IpAddr>) -> (Stay, bool) {
        let mut has_left = false;
        while let Some(until) = self.make_room(&mut has_left) {
            sleep_until(until).await;
        }
        let leave = Arc::<Notify>::default();
        self.lock().push_back(Waiting {
            address,
            since: Instant::now(),
            leave: Arc::clone(&leave),
        });
        let stay = Stay {
            entrance: Arc::clone(self),
            leave,
        };
        (stay, has_left)
    }

    /// Time of the next try; `None` if there is room.
    fn make_room(&self, has_left: &mut bool) -> Option<Instant> {
        let mut waiting = self.lock();
        if waiting.len() < MOST {
            return None;
        }
        let mut counts: HashMap<Option<IpAddr>, usize> = HashMap::new();
        for client in waiting.iter() {
            *counts.entry(client.address).or_default() += 1;
        }
        // The oldest of the address with most of them: a crowd makes room for others, not others for a crowd.
        let most = counts.values().copied().max().unwrap_or(0);
        let at = waiting
            .iter()
            .position(|client| counts.get(&client.address) == Some(&most))?;
        let until = waiting.get(at)?.since + STAY;
        if Instant::now() < until {
            return Some(until);
        }
        if let Some(oldest) = waiting.remove(at) {
            oldest.leave.notify_one();
            *has_left = true;
        }
        None
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Waiting>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Stay {
    /// Completes when this client must make room.
    pub async fn must_leave(&self) {
        self.leave.notified().await;
    }
}

impl Drop for Stay {
    fn drop(&mut self) {
        let mut waiting = self.entrance.lock();
        if let Some(at) = waiting
            .iter()
            .position(|client| Arc::ptr_eq(&client.leave, &self.leave))
        {
            waiting.remove(at);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> Option<IpAddr> {
        Some(IpAddr::from([10, 0, 0, last]))
    }

    #[tokio::test]
    async fn a_crowd_makes_room_and_others_stay() {
        let entrance = Arc::<Entrance>::default();
        let (honest, _) = entrance.enter(address(1)).await;
        let mut crowd = VecDeque::new();
        for _ in 1..MOST {
            let (stay, has_left) = entrance.enter(address(2)).await;
            assert!(!has_left);
            crowd.push_back(stay);
        }
        // Full: the next one waits until the oldest of the crowd had its time, again and again.
        for _ in 0..2 * MOST {
            let (stay, has_left) = entrance.enter(address(2)).await;
            assert!(has_left);
            let oldest = crowd.pop_front().unwrap();
            tokio::time::timeout(Duration::from_millis(1), oldest.must_leave())
                .await
                .expect("the oldest of the crowd leaves");
            crowd.push_back(stay);
        }
        assert_eq!(entrance.lock().len(), MOST);
        let stays = tokio::time::timeout(Duration::from_millis(1), honest.must_leave()).await;
        assert!(stays.is_err(), "who is alone at an address stays");
        drop(honest);
        drop(crowd);
        assert!(entrance.lock().is_empty());
    }
}
