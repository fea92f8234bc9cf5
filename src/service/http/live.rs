//! `/api/v1/events`: notifies a page of every commit, as server-sent events.

use super::shown::Shown;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Semaphore, watch};

/// Most pages that listen at once: the other connections are for queries.
pub const LISTENERS: usize = 24;

/// Interval of signs of life on a silent stream.
const ALIVE: Duration = Duration::from_secs(15);

/// The stream of one page: an event with a growing number at once, and after every commit. A page that is slow misses
/// numbers, never the last one.
pub fn events(shown: &Arc<Shown>, places: &Arc<Semaphore>, stop: watch::Receiver<bool>) -> Response {
    let Ok(place) = Arc::clone(places).try_acquire_owned() else {
        return super::problem::unavailable(format!("{LISTENERS} pages listen already")).into_response();
    };
    let bell = shown.bell();
    let stream = stream::unfold(
        (bell, stop, place, true),
        async |(mut bell, mut stop, place, is_first)| {
            if !is_first {
                tokio::select! {
                    changed = bell.changed() => changed.ok()?,
                    _ = stop.wait_for(|stop| *stop) => return None,
                }
            }
            let number = *bell.borrow_and_update();
            let event = Event::default().event("commit").data(number.to_string());
            Some((Ok::<_, Infallible>(event), (bell, stop, place, false)))
        },
    );
    Sse::new(stream)
        .keep_alive(KeepAlive::new().interval(ALIVE))
        .into_response()
}
