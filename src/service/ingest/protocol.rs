//! Parser of a client's data: bytes in, batches and ends out. It has no socket, no clock and no journal.

use super::line::{self, Line};
use super::queue::Queue;
use super::reply::LeftOut;
use super::server::TopicSet;
use super::stream::Stream;
use crate::recording::read::mcap::{Progress, Reader};
use crate::service::journal::Batch;
use mcap::MAGIC;
use std::mem;
use std::sync::Arc;

/// Longest JSON line accepted \[bytes\].
const MAX_LINE: usize = 1 << 20;

/// Reason why a client is disconnected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refusal(pub String);

/// Result of the bytes so far.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// The client gave its name: call [`Protocol::welcome`] before anything else is parsed.
    Hello(String),
    /// A batch of messages.
    Batch(Batch),
    /// The stream ended properly; the client may begin another one.
    End {
        /// Number of its messages.
        messages: u64,
        /// Messages that were not kept.
        left_out: Vec<LeftOut>,
    },
    /// The client left in the middle of a stream.
    Cut,
}

/// One client's side of a conversation.
pub struct Protocol {
    topics: Arc<TopicSet>,
    state: State,
    stream: Stream,
    /// The client closed its side.
    is_closed: bool,
    /// True if the client sent something valid.
    has_spoken: bool,
    refusal: Option<Refusal>,
    /// Number of lines so far, for messages.
    lines: u64,
    progress: u64,
}

enum State {
    /// Before a stream; at most its sender is known.
    Start(Queue),
    /// A hello waits for its welcome.
    Greeted(Queue),
    /// JSON lines.
    Lines(Queue),
    /// An MCAP stream.
    Mcap(Box<Reader<Queue>>),
    /// The stream has ended, to be reported.
    Ended(Queue),
    /// The client closed its side, and everything was reported.
    Over,
}

/// Encoding of a stream, by its first bytes.
enum Kind {
    Blank,
    Lines,
    Mcap,
}

impl Protocol {
    /// A client before its first byte; messages of other topics than these are only counted.
    pub fn new(topics: Arc<TopicSet>) -> Self {
        Self {
            topics,
            state: State::Start(Queue::default()),
            stream: Stream::default(),
            is_closed: false,
            has_spoken: false,
            refusal: None,
            lines: 0,
            progress: 0,
        }
    }

    /// Sets the topics that rods read: always named in [`Protocol::strays`] when their messages are not kept.
    pub fn name(&mut self, topics: Arc<TopicSet>) {
        self.stream.read = topics;
    }

    /// Changes the topics from here on.
    pub fn retarget(&mut self, topics: Arc<TopicSet>) {
        self.stream.retarget(&topics);
        self.topics = topics;
    }

    /// Takes bytes of the client.
    pub fn push(&mut self, bytes: &[u8]) {
        match &mut self.state {
            State::Start(queue) | State::Greeted(queue) | State::Lines(queue) | State::Ended(queue) => {
                queue.push(bytes);
            }
            State::Mcap(reader) => reader.input_mut().push(bytes),
            State::Over => {}
        }
    }

    /// Notes that the client closed its side.
    pub fn close(&mut self) {
        self.is_closed = true;
    }

    /// Answers a hello: the client continues with this message.
    pub fn welcome(&mut self, begins_at: u64) {
        if let State::Greeted(queue) = &mut self.state {
            self.state = State::Start(mem::take(queue));
            self.stream.is_named = true;
            self.stream.messages = begins_at;
        }
    }

    /// True if the client ever sent something valid.
    pub fn has_spoken(&self) -> bool {
        self.has_spoken
    }

    /// Progress: grows with every complete line or record.
    pub fn progress(&self) -> u64 {
        match &self.state {
            State::Mcap(reader) => self.progress + reader.offset(),
            _ => self.progress,
        }
    }

    /// Bytes in memory: incomplete data, and definitions.
    pub fn held(&self) -> usize {
        match &self.state {
            State::Start(queue) | State::Greeted(queue) | State::Lines(queue) | State::Ended(queue) => {
                queue.rest().len()
            }
            // Definitions are kept by the reader and by the stream.
            State::Mcap(reader) => 2 * reader.held(),
            State::Over => 0,
        }
    }

    /// Number of messages of no rod's topic since the last call.
    pub fn take_foreign(&mut self) -> u64 {
        self.stream.foreign.take_fresh()
    }

    /// First topics of this stream that belong to no rod.
    pub fn strays(&self) -> impl Iterator<Item = &str> {
        self.stream.foreign.topics()
    }

    /// Messages too large, for the first time of this stream.
    pub fn take_left_out(&mut self) -> Option<LeftOut> {
        self.stream.take_news()
    }

    /// The next topic of this client that belongs to no rod and came for the first time.
    pub fn take_stray(&mut self) -> Option<LeftOut> {
        self.stream.foreign.take_news()
    }

    /// Next step by the bytes so far; `None` until more come. `now_ns` is the time of lines that have none
    /// \[ns since 1970\].
    ///
    /// # Errors
    /// The client does not speak as it should; the same answer is given from then on.
    pub fn next(&mut self, now_ns: u64) -> Result<Option<Step>, Refusal> {
        if let Some(refusal) = &self.refusal {
            return Err(refusal.clone());
        }
        let outcome = self.advance(now_ns);
        if let Ok(Some(step)) = outcome {
            return Ok(Some(step));
        }
        self.refusal = outcome.err();
        // Data before a fault, or a pause, are good.
        if let Some(batch) = self.stream.batch() {
            return Ok(Some(Step::Batch(batch)));
        }
        match &self.refusal {
            Some(refusal) => Err(refusal.clone()),
            None if self.is_closed => Ok(self.last_step()),
            None => Ok(None),
        }
    }

    /// Reads on to the next step; `None` if there is no more to read.
    fn advance(&mut self, now_ns: u64) -> Result<Option<Step>, Refusal> {
        loop {
            if let Some(batch) = self.stream.full_batch() {
                return Ok(Some(Step::Batch(batch)));
            }
            match &mut self.state {
                State::Start(queue) => match begin(queue.rest())? {
                    None => return Ok(None),
                    Some(Kind::Blank) => {
                        queue.skip(1);
                        self.progress += 1;
                    }
                    Some(Kind::Mcap) => {
                        self.has_spoken = true;
                        let reader = Reader::of_stream(mem::take(queue));
                        self.state = State::Mcap(Box::new(reader));
                    }
                    Some(Kind::Lines) => self.state = State::Lines(mem::take(queue)),
                },
                State::Lines(queue) => {
                    let line = match queue.line() {
                        Some(line) => line,
                        None if queue.rest().len() > MAX_LINE => return Err(too_long()),
                        // The last line needs no line feed, if it is whole.
                        None if self.is_closed && line::parse(queue.rest().trim_ascii()).is_ok() => {
                            queue.everything()
                        }
                        None => return Ok(None),
                    };
                    if let Some(step) = self.line(&line, now_ns)? {
                        return Ok(Some(step));
                    }
                }
                State::Mcap(reader) => match self.stream.record(reader, &self.topics)? {
                    Progress::More => {}
                    Progress::Wait | Progress::Truncated => return Ok(None),
                    Progress::Complete => {
                        self.progress += reader.offset();
                        if let State::Mcap(reader) = mem::replace(&mut self.state, State::Over) {
                            self.state = State::Ended(reader.into_input());
                        }
                    }
                },
                State::Ended(queue) => {
                    if let Some(batch) = self.stream.batch() {
                        return Ok(Some(Step::Batch(batch)));
                    }
                    self.state = State::Start(mem::take(queue));
                    return Ok(Some(self.end()));
                }
                State::Greeted(_) | State::Over => return Ok(None),
            }
        }
    }

    /// Handles one line of a client that speaks JSON.
    fn line(&mut self, line: &[u8], now_ns: u64) -> Result<Option<Step>, Refusal> {
        self.progress += 1;
        self.lines += 1;
        if line.len() > MAX_LINE {
            return Err(too_long());
        }
        let line = line.trim_ascii();
        if line.is_empty() {
            return Ok(None);
        }
        let number = self.lines;
        let parsed = line::parse(line).map_err(|what| Refusal(format!("line {number} {what}")))?;
        self.has_spoken = true;
        match parsed {
            Line::Data { topic, time } => {
                let time = time.unwrap_or(now_ns);
                self.stream.line(topic, time, line, &self.topics)?;
            }
            Line::End => self.switch(State::Ended),
            Line::Hello(_) if self.stream.is_named || self.stream.messages > 0 => {
                return Err(Refusal(format!(
                    "line {number} says hello in the middle of a stream"
                )));
            }
            Line::Hello(name) => {
                self.switch(State::Greeted);
                return Ok(Some(Step::Hello(name)));
            }
        }
        Ok(None)
    }

    /// Changes from lines to another state, with the remaining bytes.
    fn switch(&mut self, to: fn(Queue) -> State) {
        if let State::Lines(queue) = &mut self.state {
            self.state = to(mem::take(queue));
        }
    }

    fn end(&mut self) -> Step {
        let mut ended = mem::take(&mut self.stream);
        let left_out = ended.left_out();
        self.stream.foreign = ended.foreign.carried();
        self.stream.read = ended.read;
        Step::End {
            messages: ended.messages,
            left_out,
        }
    }

    /// Last step after the client closed its side.
    fn last_step(&mut self) -> Option<Step> {
        let is_named = self.stream.is_named;
        match mem::replace(&mut self.state, State::Over) {
            State::Start(queue) if queue.rest().is_empty() && !is_named => None,
            // A client without a name that speaks JSON has no other way to end.
            State::Lines(queue) if queue.rest().trim_ascii().is_empty() && !is_named => Some(self.end()),
            State::Over => None,
            _ => Some(Step::Cut),
        }
    }
}

fn too_long() -> Refusal {
    Refusal(format!("a line of more than {MAX_LINE} bytes"))
}

/// Encoding of a stream by its first bytes; `None` while they are too few.
fn begin(bytes: &[u8]) -> Result<Option<Kind>, Refusal> {
    let head = bytes.get(..MAGIC.len()).unwrap_or(bytes);
    match bytes {
        [] => Ok(None),
        [b'\n' | b'\r' | b' ' | b'\t', ..] => Ok(Some(Kind::Blank)),
        [b'{', ..] => Ok(Some(Kind::Lines)),
        _ if head == MAGIC => Ok(Some(Kind::Mcap)),
        _ if MAGIC.starts_with(head) => Ok(None),
        [0x16, 3, ..] => Err(Refusal(
            "this is TLS, but this socket does not speak it".to_owned(),
        )),
        _ => Err(Refusal("neither MCAP nor JSON lines".to_owned())),
    }
}
