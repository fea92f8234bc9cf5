//! Limits the connections: a new one waits until it has asked something, the one idle longest makes room, and a few
//! places are left for health and metrics.

use axum::body::{Body, Bytes};
use hyper::body::{Body as Streamed, Frame, SizeHint};
use std::cmp::Reverse;
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
/// Further connections that have not asked anything yet.
const WAITING: usize = 256;
/// Paths answered on reserved places.
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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Row {
    Waiting,
    Ordinary,
    Reserved,
}

struct Occupied {
    address: IpAddr,
    row: Row,
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
}

/// Answer to a connection that asks for a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    Free,
    /// Another connection had to leave for it.
    Freed,
    /// All are busy.
    Refused,
}

impl Seats {
    /// Seats a new connection from `address` among those that have not asked anything yet; also true if another one had
    /// to leave for it.
    pub fn wait(self: &Arc<Self>, address: IpAddr) -> (Seat, bool) {
        let mut inner = self.lock();
        let has_left = inner.row(Row::Waiting).count() >= WAITING && inner.let_go(Row::Waiting, None);
        let (number, leave) = (inner.next, Arc::<Notify>::default());
        inner.next += 1;
        let occupied = Occupied {
            address,
            row: Row::Waiting,
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
        };
        (seat, has_left)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn row(&self, row: Row) -> impl Iterator<Item = (&u64, &Occupied)> {
        self.seats.iter().filter(move |(_, seat)| seat.row == row)
    }

    /// Lets the connection go that is idle longest, of an address or of the one with most; false if all are busy.
    fn let_go(&mut self, row: Row, of: Option<IpAddr>) -> bool {
        let mut counts: HashMap<IpAddr, usize> = HashMap::new();
        for (_, seat) in self.row(row) {
            *counts.entry(seat.address).or_default() += 1;
        }
        let idle = self.row(row).filter(|(_, seat)| seat.busy == 0);
        let asked = idle.filter(|(_, seat)| of.is_none_or(|address| seat.address == address));
        let victim = asked.min_by_key(|(_, seat)| (Reverse(counts.get(&seat.address)), seat.idle_since));
        let victim = victim.map(|(number, _)| *number);
        match victim.and_then(|victim| self.seats.remove(&victim)) {
            Some(seat) => {
                seat.leave.notify_one();
                true
            }
            None => false,
        }
    }

    /// Place for a request from `address` on a connection that has no ordinary one.
    fn place(&mut self, address: IpAddr, now: Row, path: &str) -> (Row, Place) {
        let of_address = self
            .row(Row::Ordinary)
            .filter(|(_, seat)| seat.address == address);
        let of = (of_address.count() >= OF_ADDRESS).then_some(address);
        if of.is_none() && self.row(Row::Ordinary).count() < CONNECTIONS {
            return (Row::Ordinary, Place::Free);
        }
        // Health and metrics drive nobody out who was asking for something else.
        let (row, of) = match VITAL.contains(&path) {
            true => (Row::Reserved, None),
            false => (Row::Ordinary, of),
        };
        if row == Row::Reserved && (now == row || self.row(row).count() < RESERVED) {
            return (row, Place::Free);
        }
        match self.let_go(row, of) {
            true => (row, Place::Freed),
            false => (now, Place::Refused),
        }
    }
}

impl Seat {
    /// Completes when this connection must make room.
    pub async fn must_leave(&self) {
        self.leave.notified().await;
    }

    /// Takes the place that a request needs, unless the connection has it already; the seat is to be marked busy before.
    pub fn sit(&self, path: &str) -> Place {
        let mut inner = self.seats.lock();
        let Some((address, now)) = inner.seats.get(&self.number).map(|seat| (seat.address, seat.row)) else {
            return Place::Refused;
        };
        if now == Row::Ordinary {
            return Place::Free;
        }
        let (row, place) = inner.place(address, now, path);
        if let Some(seat) = inner.seats.get_mut(&self.number) {
            seat.row = row;
        }
        place
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

    /// A connection that is busy with a request.
    fn asking(seats: &Arc<Seats>, last: u8, path: &str) -> (Arc<Seat>, Busy, Place) {
        let seat = Arc::new(seats.wait(address(last)).0);
        let busy = seat.busy();
        let place = seat.sit(path);
        (seat, busy, place)
    }

    /// A connection that asked something and is silent since.
    fn kept(seats: &Arc<Seats>, last: u8, path: &str) -> (Arc<Seat>, Place) {
        let (seat, _, place) = asking(seats, last, path);
        (seat, place)
    }

    fn is_there(seats: &Seats, seat: &Seat) -> bool {
        seats.lock().seats.contains_key(&seat.number)
    }

    #[test]
    fn the_silent_make_room_and_health_is_asked_when_all_are_busy() {
        let seats = Arc::<Seats>::default();
        let honest = kept(&seats, 1, "/").0;
        let crowd: Vec<_> = (0..CONNECTIONS - 1)
            .map(|n| kept(&seats, 2 + (n % 2) as u8, "/").0)
            .collect();
        let (newest, place) = kept(&seats, 9, "/");
        assert_eq!(place, Place::Freed);
        // One of the crowd left, not the one that was alone at its address, though it is silent longest.
        assert!(is_there(&seats, &honest) && !is_there(&seats, &crowd[0]));
        let all = crowd[1..].iter().chain([&honest, &newest]);
        let busy: Vec<_> = all.map(Seat::busy).collect();
        assert_eq!(kept(&seats, 7, "/").1, Place::Refused);
        let vital: Vec<_> = (0..RESERVED).map(|_| asking(&seats, 7, "/healthz")).collect();
        for (seat, _, place) in &vital {
            assert_eq!(
                (*place, seat.sit("/"), seat.sit("/metrics")),
                (Place::Free, Place::Refused, Place::Free)
            );
        }
        assert_eq!(kept(&seats, 8, "/healthz").1, Place::Refused);
        // Nobody else had to leave for them, and a kept connection of theirs is one like any other once there is room.
        assert!(crowd[1..].iter().all(|seat| is_there(&seats, seat)));
        drop(busy);
        assert_eq!(vital[0].0.sit("/"), Place::Freed);
    }

    #[test]
    fn one_address_does_not_take_all() {
        let seats = Arc::<Seats>::default();
        let held: Vec<_> = (0..OF_ADDRESS).map(|_| kept(&seats, 1, "/")).collect();
        assert!(held.iter().all(|(_, place)| *place == Place::Free));
        assert_eq!(kept(&seats, 1, "/").1, Place::Freed);
        assert_eq!(kept(&seats, 2, "/").1, Place::Free);
    }

    #[test]
    fn who_asks_nothing_takes_no_place_and_leaves_first() {
        let seats = Arc::<Seats>::default();
        let asked = kept(&seats, 1, "/").0;
        let early = seats.wait(address(2)).0;
        let mute: Vec<_> = (0..2 * WAITING).map(|_| seats.wait(address(1))).collect();
        assert_eq!(mute.iter().filter(|(_, has_left)| *has_left).count(), WAITING + 1);
        // The oldest of the address with most left.
        assert!(is_there(&seats, &asked) && is_there(&seats, &early));
        assert!(
            mute[..WAITING + 1]
                .iter()
                .all(|(seat, _)| !is_there(&seats, seat))
        );
        assert_eq!(early.sit("/"), Place::Free);
        assert_eq!(mute[0].0.sit("/"), Place::Refused);
    }
}
