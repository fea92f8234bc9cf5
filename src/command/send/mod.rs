//! `tirante send`: sends recordings to the daemon's socket, at a chosen speed.

mod link;
mod playback;
mod stream;

use super::BadArguments;
use super::progress::Progress;
use crate::config::settings::ingest::names;
use crate::recording::read;
use crate::service::ingest::{LeftOut, Reply};
use crate::service::journal::MAX_MESSAGE;
use crate::site::clock;
use link::{Address, Link, TlsArgs};
use playback::{Message, Piece, Playback};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, HashSet};
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::Duration;
use stream::Stream;
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tokio_rustls::TlsConnector;

/// Age of its first message at which a chunk is closed.
const FLUSH_AFTER: Duration = Duration::from_millis(100);

/// Size at which a chunk is closed \[bytes\].
const FLUSH_BYTES: usize = 256 << 10;

/// Time without data after which a sign of life is sent.
const ALIVE_EVERY: Duration = Duration::from_secs(20);

/// Longest wait for the daemon's answer to a hello, and to the end of the stream.
const PATIENCE: Duration = Duration::from_secs(300);

/// Shortest and longest pause between attempts to connect.
const BACK_OFF: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));

/// Send recordings to a running daemon, at a chosen speed.
///
/// They go into its socket as one MCAP stream.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante send recordings/todi-pull.mcap --to tcp://127.0.0.1:7415
  tirante send day.mcap --to unix:///run/tirante/ingest.sock \\
      --sender north-laser --speed 10
  tirante send day.mcap --to tcp://127.0.0.1:7415 --speed max --stamp-now
  tirante send day.mcap --to tcp://127.0.0.1:7415 --topic '/nave/*'
  tirante send day.mcap --to tcp://tower.example:7415 --tls-ca ca.pem \\
      --tls-certificate me.pem --tls-key me.key

Log times decide when a message is sent. With --sender the daemon acknowledges
what is on its disk; after a cut the command connects again (after 1 s, then
longer, up to 30 s) and goes on from there. Without --sender a cut is the end.
Exit code 0 says that everything is durable; 1 that it is not, or that a
recording is damaged; 3 that some was left out, with the reason: topics that no
rod reads, among others. With --topic they are not sent, and nothing is left
out; 3 says then that no recording has such a topic.")]
pub struct Args {
    /// MCAP recordings, or folders of them; sent in the order of their data.
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,

    /// Address of the daemon's socket: tcp://HOST:PORT or unix:///PATH.
    #[arg(long, value_name = "ADDRESS")]
    pub to: Address,

    /// Name of the sender: 1 to 64 letters, digits, '-', '_' and '.'. A name has one stream at a time.
    #[arg(long, value_name = "NAME")]
    pub sender: Option<String>,

    /// Resume an earlier `tirante send` of the same recordings under the same name.
    #[arg(long, requires = "sender", conflicts_with = "stamp_now")]
    pub resume: bool,

    /// Send only the messages of this topic; a `*` at the end stands for anything. Repeatable.
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,

    /// Speed as a multiple of the recorded one, or max.
    #[arg(long, value_name = "TIMES", default_value = "1")]
    pub speed: Speed,

    /// Shift log and publish times so that the first message is at the present time. Times inside the
    /// messages (fields) are unchanged.
    #[arg(long)]
    pub stamp_now: bool,

    /// TLS options.
    #[command(flatten)]
    pub tls: TlsArgs,
}

impl Args {
    /// True if messages of a topic are to be sent.
    fn wants(&self, topic: &str) -> bool {
        self.topics.is_empty() || self.topics.iter().any(|pattern| names(pattern, topic))
    }
}

/// Speed of sending.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    /// Multiple of the recorded speed.
    Times(f64),
    /// As fast as the daemon accepts.
    Max,
}

impl FromStr for Speed {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.parse() {
            _ if text == "max" => Ok(Self::Max),
            Ok(times) if (1e-3..=1e6).contains(&times) => Ok(Self::Times(times)),
            _ => Err("a number from 0.001 to 1000000, or max"),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A recording cannot be found, a certificate not used, or not everything became durable.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if let Some(name) = &args.sender {
        let is_name = (1..=64).contains(&name.len())
            && name
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
        if !is_name {
            let text = format!("--sender {name}: 1 to 64 letters, digits, '-', '_' and '.'");
            return Err(BadArguments(text).into());
        }
    }
    let files = read::recordings(&args.files)
        .into_iter()
        .collect::<Result<Vec<_>, _>>()
        // Its words hold the cause already.
        .map_err(|error| anyhow::Error::msg(error.to_string()))?;
    let total = files
        .iter()
        .filter_map(|file| file.metadata().ok())
        .map(|data| data.len())
        .sum();
    let errand = Errand {
        args,
        tls: args.tls.connector()?,
        files,
        total,
        bar: Progress::new(
            total,
            "{bar:40} {percent:>3} %  {bytes} of {total_bytes} sent, {eta} left",
        ),
        start: Cell::new(None),
        shift_ns: Cell::new(None),
        durable: Cell::new(0),
        losses: Cell::new(0),
        notes: Cell::new(0),
        too_large: Cell::new(0),
        left_out: RefCell::default(),
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let outcome = runtime.block_on(async {
        tokio::select! {
            outcome = errand.run() => outcome,
            _ = tokio::signal::ctrl_c() => Err(anyhow::anyhow!("interrupted")),
        }
    });
    let durable = errand.durable.get();
    let losses = errand.losses.get();
    let not_kept: u64 = errand.left_out.take().into_values().sum();
    // These were never among those sent.
    let left_out = not_kept + errand.too_large.get();
    drop(errand);
    let messages = outcome.map_err(|error| match &args.sender {
        Some(sender) => error.context(format!(
            "not everything was sent: {durable} messages of {sender} are durable (--resume goes on after them)"
        )),
        None => error.context("not everything was sent"),
    })?;
    super::print(told(messages.saturating_sub(not_kept), left_out).as_bytes())?;
    if !args.topics.is_empty() && messages + left_out + durable == 0 {
        tell!("warning: no message of these recordings has a topic that --topic names");
        return Ok(ExitCode::from(super::WITH_LOSSES));
    }
    Ok(match (losses, left_out) {
        (0, 0) => ExitCode::SUCCESS,
        (0, _) => ExitCode::from(super::WITH_LOSSES),
        _ => ExitCode::FAILURE,
    })
}

/// Outcome in words.
fn told(durable: u64, left_out: u64) -> String {
    let durable = match durable {
        1 => "1 message is durable".to_owned(),
        _ => format!("{durable} messages are durable"),
    };
    match left_out {
        0 => format!("{durable}\n"),
        1 => format!("{durable}, 1 was left out\n"),
        _ => format!("{durable}, {left_out} were left out\n"),
    }
}

/// State shared by the attempts to send.
struct Errand<'a> {
    args: &'a Args,
    tls: Option<TlsConnector>,
    files: Vec<PathBuf>,
    /// Total size of the files \[bytes\].
    total: u64,
    bar: Progress,
    /// Time of sending the first message, and its log time; paces all that follow.
    start: Cell<Option<(Instant, u64)>>,
    /// Offset added to every time, once the first is known \[ns\].
    shift_ns: Cell<Option<i128>>,
    /// Number of messages that the daemon acknowledged.
    durable: Cell<u64>,
    /// Number of damaged recordings.
    losses: Cell<usize>,
    /// Number of facts told about the recordings.
    notes: Cell<usize>,
    /// Number of messages too large for a socket, which no attempt sends.
    too_large: Cell<u64>,
    /// Number of messages that the daemon did not keep, by reason.
    left_out: RefCell<BTreeMap<String, u64>>,
}

/// Reason why an attempt failed.
enum Failure {
    /// Another attempt may succeed.
    Again(String),
    /// No further attempt can succeed.
    Final(anyhow::Error),
}

impl From<io::Error> for Failure {
    fn from(fault: io::Error) -> Self {
        Self::Again(fault.to_string())
    }
}

impl From<mcap::McapError> for Failure {
    fn from(fault: mcap::McapError) -> Self {
        Self::Final(fault.into())
    }
}

impl Errand<'_> {
    /// Sends until everything is durable; returns the number of messages.
    async fn run(&self) -> anyhow::Result<u64> {
        let mut pause = BACK_OFF.0;
        let mut is_first = true;
        loop {
            let before = self.durable.get();
            let why = match self.attempt(&mut is_first).await {
                Ok(messages) => return Ok(messages),
                Err(Failure::Final(error)) => return Err(error),
                Err(Failure::Again(why)) if self.args.sender.is_none() => anyhow::bail!(why),
                Err(Failure::Again(why)) => why,
            };
            if self.durable.get() > before {
                pause = BACK_OFF.0;
            }
            self.bar
                .say(&format!("warning: {why}; again in {} s", pause.as_secs()));
            sleep(pause).await;
            pause = (2 * pause).min(BACK_OFF.1);
        }
    }

    /// Runs one connection from its beginning to the end of the stream.
    async fn attempt(&self, is_first: &mut bool) -> Result<u64, Failure> {
        let again = |error: anyhow::Error| Failure::Again(format!("{error:#}"));
        let opened = Link::open(&self.args.to, self.tls.as_ref()).await;
        let mut link = opened.map_err(|error| {
            let reason = error
                .chain()
                .find_map(|cause| link::refusal(cause.downcast_ref()?));
            match reason {
                Some(reason) => Failure::Final(anyhow::anyhow!("{}: {reason}", self.args.to)),
                None => again(error),
            }
        })?;
        let mut skip = 0;
        if let Some(sender) = &self.args.sender {
            skip = match link.hello(sender, PATIENCE).await.map_err(again)? {
                Ok(messages) => messages,
                Err(reply) => return Err(refused(reply)),
            };
            if std::mem::take(is_first) && skip > 0 && !self.args.resume {
                return Err(Failure::Final(anyhow::anyhow!(
                    "the daemon has {skip} messages of a stream of {sender} that was cut: --resume goes on after them if \
                     these are the same recordings, else take another name"
                )));
            }
            self.durable.set(skip);
        }
        let mut playback = Playback::new(self.files.clone());
        let mut stream = Stream::new()?;
        let mut messages = 0;
        let mut losses = 0;
        let mut notes = 0;
        let mut too_large = 0;
        // Channels of the open recording that are not asked for.
        let mut unwanted = HashSet::new();
        // When the chunk under way is to be closed.
        let mut flush_at = None;
        let mut on_answer = |reply| self.heard(reply);
        while let Some(piece) = playback.next() {
            let mut message = match piece {
                Piece::File => {
                    stream.begin_file();
                    unwanted.clear();
                    continue;
                }
                Piece::Channel(channel) if !self.args.wants(&channel.topic) => {
                    unwanted.insert(channel.id);
                    continue;
                }
                Piece::Message(message) if unwanted.contains(&message.channel) => continue,
                Piece::Channel(channel) => {
                    stream.channel(&channel)?;
                    continue;
                }
                Piece::Note(what) => {
                    notes += 1;
                    if notes > self.notes.get() {
                        self.notes.set(notes);
                        self.bar.say(&format!("warning: {what}"));
                    }
                    continue;
                }
                Piece::Loss(what) => {
                    losses += 1;
                    if losses > self.losses.get() {
                        self.losses.set(losses);
                        self.bar.say(&format!("error: {what}"));
                    }
                    continue;
                }
                Piece::Message(message) if message.data.len() > MAX_MESSAGE => {
                    too_large += 1;
                    if self.too_large.get() == 0 {
                        self.bar.say(&format!(
                            "error: messages are left out: larger than {MAX_MESSAGE} bytes, too large for a socket"
                        ));
                    }
                    self.too_large.set(too_large.max(self.too_large.get()));
                    continue;
                }
                Piece::Message(message) => message,
            };
            self.stamp(&mut message);
            messages += 1;
            if messages <= skip {
                continue;
            }
            let due = self.due(message.log_time);
            loop {
                let now = Instant::now();
                let is_full = stream.pending() >= FLUSH_BYTES
                    || (stream.pending() > 0 && message.data.len() >= FLUSH_BYTES);
                if is_full || flush_at.is_some_and(|at| at <= now) {
                    stream.flush()?;
                    flush_at = None;
                    link.send(&stream.take(), &mut on_answer).await?;
                    self.bar.set(playback.bytes(), self.total);
                }
                let Some(due) = due.filter(|due| *due > now) else {
                    break;
                };
                let until = flush_at.unwrap_or(now + ALIVE_EVERY).min(due);
                tokio::select! {
                    () = sleep_until(until) => {
                        if flush_at.is_none() && until < due {
                            stream.sign_of_life()?;
                            link.send(&stream.take(), &mut on_answer).await?;
                        }
                    }
                    answer = link.answer() => match answer {
                        Some(answer) => on_answer(answer)?,
                        None => return Err(Failure::Again("the daemon closed the connection".to_owned())),
                    },
                }
            }
            stream.message(&message)?;
            flush_at.get_or_insert_with(|| Instant::now() + FLUSH_AFTER);
        }
        if messages < skip {
            return Err(Failure::Final(anyhow::anyhow!(
                "the daemon has {skip} messages, these recordings hold {messages}: they are not the ones it had before"
            )));
        }
        stream.finish()?;
        link.send(&stream.take(), &mut on_answer).await?;
        self.bar.set(playback.bytes(), self.total);
        loop {
            match timeout(PATIENCE, link.answer()).await {
                Ok(Some(Reply::Done {
                    messages: durable,
                    left_out,
                })) if durable == messages => {
                    for LeftOut { messages, reason } in left_out {
                        self.leave_out(&reason, messages);
                    }
                    return Ok(messages);
                }
                Ok(Some(Reply::Done {
                    messages: durable, ..
                })) => {
                    return Err(Failure::Final(anyhow::anyhow!(
                        "{messages} messages were sent, the daemon has {durable}"
                    )));
                }
                Ok(Some(answer)) => self.heard(answer)?,
                Ok(None) => return Err(Failure::Again("the daemon closed the connection".to_owned())),
                Err(_) => return Err(Failure::Again("the daemon does not answer".to_owned())),
            }
        }
    }

    /// Notes the total of messages not kept for a reason, and reports the first.
    fn leave_out(&self, reason: &str, messages: u64) {
        let mut left_out = self.left_out.borrow_mut();
        let known = left_out.entry(reason.to_owned()).or_insert(0);
        if *known == 0 {
            self.bar.say(&format!("error: messages are left out: {reason}"));
        }
        *known = messages.max(*known);
    }

    /// Shifts the times of a message to now, if asked for.
    fn stamp(&self, message: &mut Message) {
        if !self.args.stamp_now {
            return;
        }
        let shift = self
            .shift_ns
            .get()
            .unwrap_or_else(|| i128::from(clock::now_ns()) - i128::from(message.log_time));
        self.shift_ns.set(Some(shift));
        let moved = |time: u64| u64::try_from(i128::from(time) + shift).unwrap_or(time);
        message.log_time = moved(message.log_time);
        message.publish_time = moved(message.publish_time);
    }

    /// Time at which a message is due; `None` for now.
    fn due(&self, log_time: u64) -> Option<Instant> {
        let Speed::Times(times) = self.args.speed else {
            return None;
        };
        let (begun, first) = self.start.get().unwrap_or_else(|| (Instant::now(), log_time));
        self.start.set(Some((begun, first)));
        let after_s = log_time.saturating_sub(first) as f64 * 1e-9 / times;
        begun.checked_add(Duration::try_from_secs_f64(after_s).ok()?)
    }

    /// Handles an answer of the daemon.
    fn heard(&self, reply: Reply) -> Result<(), Failure> {
        match reply {
            Reply::Ack { messages } => {
                self.durable.set(messages);
                Ok(())
            }
            Reply::LeftOut(LeftOut { messages, reason }) => {
                self.leave_out(&reason, messages);
                Ok(())
            }
            other => Err(refused(other)),
        }
    }
}

/// Failure by an answer that ends the attempt.
fn refused(reply: Reply) -> Failure {
    match reply {
        Reply::Error { reason, again: true } => {
            Failure::Again(format!("the daemon closed the connection: {reason}"))
        }
        Reply::Error { reason, .. } => Failure::Final(anyhow::anyhow!("the daemon refuses: {reason}")),
        other => Failure::Final(anyhow::anyhow!("the daemon answers {other} out of turn")),
    }
}
