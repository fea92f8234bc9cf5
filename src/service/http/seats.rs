//! Limits the connections: the one that is idle longest makes room, and when all are busy a few places are
//! left for health and metrics.

use axum::body::{Body, Bytes};
use hyper::body::{Body as Streamed, Frame, SizeHint};
use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Instant;
use tokio::sync::Notify;

/// Most connections at once.
pub(super) const CONNECTIONS: usize = 64;
/// Most connections of one address.
const OF_ADDRESS: usize = 48;
/// Further connections, for health and metrics.
const RESERVED: usize = 8;
/// Paths answered on those.
const VITAL: [&str; 3] = ["/healthz", "/readyz", "/metrics"];

/// Present connections.
#[derive(Default)]
pub(super) struct Seats {
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    seats: BTreeMap<u64, Occupied>,
    next: u64,
}

struct Occupied {
    address: IpAddr,
    is_reserved: bool,
    /// Number of requests being answered.
    busy: usize,
    /// Time since which there is none.
    idle_since: Instant,
    leave: Arc<Notify>,
}

/// A connection's seat, free again when it is dropped.
pub(super) struct Seat {
    seats: Arc<Seats>,
    number: u64,
    leave: Arc<Notify>,
    is_reserved: bool,
}

impl Seats {
    /// Takes a seat for a connection from `address`; also true if another one had to leave for it. `None` if
    /// all are busy.
    pub fn take(self: &Arc<Self>, address: IpAddr) -> Option<(Seat, bool)> {
        let mut inner = self.lock();
        let of_address = inner
            .ordinary()
            .filter(|(_, seat)| seat.address == address)
            .count();
        let is_full = inner.ordinary().count() >= CONNECTIONS;
        let victim = match (is_full, of_address >= OF_ADDRESS) {
            (false, false) => None,
            (_, true) => Some(inner.idle_longest(Some(address))),
            (true, false) => Some(inner.idle_longest(None)),
        };
        let is_reserved = victim == Some(None);
        let has_left = match victim.flatten().and_then(|victim| inner.seats.remove(&victim)) {
            Some(seat) => {
                seat.leave.notify_one();
                true
            }
            None => false,
        };
        if is_reserved && inner.seats.len() - inner.ordinary().count() >= RESERVED {
            return None;
        }
        let (number, leave) = (inner.next, Arc::<Notify>::default());
        inner.next += 1;
        let occupied = Occupied {
            address,
            is_reserved,
            busy: 0,
            idle_since: Instant::now(),
            leave: Arc::clone(&leave),
        };
        inner.seats.insert(number, occupied);
        drop(inner);
        let seat = Seat {
            seats: Arc::clone(self),
            number,
            leave,
            is_reserved,
        };
        Some((seat, has_left))
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn ordinary(&self) -> impl Iterator<Item = (&u64, &Occupied)> {
        self.seats.iter().filter(|(_, seat)| !seat.is_reserved)
    }

    /// The connection that is idle longest, of an address or of the one with most.
    fn idle_longest(&self, of: Option<IpAddr>) -> Option<u64> {
        let mut counts: HashMap<IpAddr, usize> = HashMap::new();
        for (_, seat) in self.ordinary() {
            *counts.entry(seat.address).or_default() += 1;
        }
        let idle = self.ordinary().filter(|(_, seat)| seat.busy == 0);
        let asked = idle.filter(|(_, seat)| of.is_none_or(|address| seat.address == address));
        asked
            .min_by_key(|(_, seat)| {
                let others = counts.get(&seat.address).copied().unwrap_or(0);
                (std::cmp::Reverse(others), seat.idle_since)
            })
            .map(|(number, _)| *number)
    }
}

impl Seat {
    /// Completes when this connection must make room.
    pub async fn must_leave(&self) {
        self.leave.notified().await;
    }

    /// True if a request may be answered on this seat.
    pub fn may_ask(&self, path: &str) -> bool {
        !self.is_reserved || VITAL.contains(&path)
    }

    /// Marks the seat as busy until the returned value is dropped.
    pub fn busy(self: &Arc<Self>) -> Busy {
        if let Some(seat) = self.seats.lock().seats.get_mut(&self.number) {
            seat.busy += 1;
        }
        Busy(Arc::clone(self))
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.seats.lock().seats.remove(&self.number);
    }
}

/// A request being answered.
pub(super) struct Busy(Arc<Seat>);

impl Drop for Busy {
    fn drop(&mut self) {
        if let Some(seat) = self.0.seats.lock().seats.get_mut(&self.0.number) {
            seat.busy = seat.busy.saturating_sub(1);
            seat.idle_since = Instant::now();
        }
    }
}

/// An answer's content; its connection is busy until all of it was taken.
pub(super) struct Content {
    body: Body,
    _busy: Busy,
}

impl Content {
    pub fn new(body: Body, busy: Busy) -> Self {
        Self { body, _busy: busy }
    }
}

impl Streamed for Content {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, last])
    }

    #[test]
    fn the_silent_make_room_and_health_is_asked_when_all_are_busy() {
        let seats = Arc::<Seats>::default();
        let honest = Arc::new(seats.take(address(1)).unwrap().0);
        let crowd: Vec<_> = (0..CONNECTIONS - 1)
            .map(|n| Arc::new(seats.take(address(2 + (n % 2) as u8)).unwrap().0))
            .collect();
        let (newest, has_left) = seats.take(address(9)).unwrap();
        assert!(has_left && newest.may_ask("/"));
        // One of the crowd left, not the one that was alone at its address, though it is silent longest.
        assert!(seats.lock().seats.contains_key(&honest.number));
        assert!(!seats.lock().seats.contains_key(&crowd[0].number));
        let newest = Arc::new(newest);
        let all = crowd[1..].iter().chain([&honest, &newest]);
        let busy: Vec<_> = all.map(Seat::busy).collect();
        let reserved: Vec<_> = (0..RESERVED).map(|_| seats.take(address(7)).unwrap()).collect();
        for (seat, has_left) in &reserved {
            assert!(!has_left && seat.may_ask("/healthz") && !seat.may_ask("/"));
        }
        assert!(seats.take(address(8)).is_none());
        drop(busy);
        assert!(seats.take(address(8)).unwrap().1);
    }

    #[test]
    fn one_address_does_not_take_all() {
        let seats = Arc::<Seats>::default();
        let held: Vec<_> = (0..OF_ADDRESS).map(|_| seats.take(address(1)).unwrap()).collect();
        assert!(held.iter().all(|(_, has_left)| !has_left));
        assert!(seats.take(address(1)).unwrap().1);
        assert!(!seats.take(address(2)).unwrap().1);
    }
}
