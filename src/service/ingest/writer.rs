//! Writes answers to one client, for as long as it reads them.

use super::reply::Reply;
use std::time::Duration;
use tokio::io::{AsyncWrite, AsyncWriteExt};
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, sleep_until, timeout};

/// Shortest time between two acks.
const ACK_EVERY: Duration = Duration::from_millis(200);

/// Longest time without reading before a client gets no more answers.
const PATIENCE: Duration = Duration::from_secs(10);

/// Instruction to the writer.
pub(super) enum Said {
    /// Send this answer.
    Reply(Reply),
    /// Send acks from here on, for durable messages beyond this number.
    Follow(u64, watch::Receiver<u64>),
    /// Send no more acks.
    Unfollow,
}

struct Acks {
    durable: watch::Receiver<u64>,
    last: u64,
    not_before: Instant,
}

/// Sends all answers, and closes our side at the end.
pub(super) async fn write(mut output: impl AsyncWrite + Unpin, mut said: mpsc::Receiver<Said>) {
    let mut acks = None;
    loop {
        let reply = tokio::select! {
            biased;
            what = said.recv() => match what {
                None => break,
                Some(Said::Reply(reply)) => reply,
                Some(Said::Follow(last, durable)) => {
                    acks = Some(Acks { durable, last, not_before: Instant::now() });
                    continue;
                }
                Some(Said::Unfollow) => {
                    acks = None;
                    continue;
                }
            },
            messages = next_ack(&mut acks) => Reply::Ack { messages },
        };
        let line = format!("{reply}\n");
        let written = timeout(PATIENCE, async {
            output.write_all(line.as_bytes()).await?;
            output.flush().await
        });
        if !matches!(written.await, Ok(Ok(()))) {
            return;
        }
    }
    let _ = timeout(PATIENCE, output.shutdown()).await;
}

/// Next number of durable messages to acknowledge.
async fn next_ack(acks: &mut Option<Acks>) -> u64 {
    let Some(Acks {
        durable,
        last,
        not_before,
    }) = acks
    else {
        return std::future::pending().await;
    };
    sleep_until(*not_before).await;
    let known = *last;
    let Ok(messages) = durable
        .wait_for(|messages| *messages > known)
        .await
        .map(|messages| *messages)
    else {
        return std::future::pending().await;
    };
    *last = messages;
    *not_before = Instant::now() + ACK_EVERY;
    messages
}
