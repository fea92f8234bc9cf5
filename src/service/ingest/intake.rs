//! Destination of the clients' data: the journal, or its substitute in tests.

use crate::service::journal::{Batch, Closed, End, Handle, Line};
use std::future::Future;
use tokio::sync::watch;

/// Receives streams.
pub trait Intake: Clone + Send + Sync + 'static {
    /// Input of one stream.
    type Line: IntakeLine;

    /// Begins or resumes a stream, see [`Handle::connect`].
    fn connect(&self, sender: Option<&str>) -> impl Future<Output = Result<Self::Line, Closed>> + Send;
}

/// Input of one stream; dropped without [`IntakeLine::end`], it counts as broken.
pub trait IntakeLine: Send + 'static {
    /// See [`Line::begins_at`].
    fn begins_at(&self) -> u64;

    /// See [`Line::append`].
    fn append(&mut self, batch: Batch) -> impl Future<Output = Result<(), Closed>> + Send;

    /// See [`Line::durable`].
    fn durable(&self) -> watch::Receiver<u64>;

    /// See [`Line::end`].
    fn end(self, how: End) -> impl Future<Output = Result<(), Closed>> + Send;
}

impl Intake for Handle {
    type Line = Line;

    async fn connect(&self, sender: Option<&str>) -> Result<Line, Closed> {
        Handle::connect(self, sender).await
    }
}

impl IntakeLine for Line {
    fn begins_at(&self) -> u64 {
        Line::begins_at(self)
    }

    async fn append(&mut self, batch: Batch) -> Result<(), Closed> {
        Line::append(self, batch).await
    }

    fn durable(&self) -> watch::Receiver<u64> {
        Line::durable(self)
    }

    async fn end(self, how: End) -> Result<(), Closed> {
        Line::end(self, how).await
    }
}
