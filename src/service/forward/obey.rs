//! Carrying out of the centre's commands: each at most once, whatever is repeated, with its outcome in the store's log.

use super::command::{self, Action, Order, Refusal, Signed};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::config::Config;
use crate::recording::atomic::AtomicFile;
use crate::service::telemetry::{Fault, Health};
use crate::site::clock;
use crate::site::store::{Asked, Judged, Reader, StoreError, latest_command, put_command};
use crate::site::text;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Subject of the condition of a configuration that waits for a person.
const OFFERED: &str = "offered configuration";
/// Longest reason told of a configuration with faults \[characters\].
const LONGEST: usize = 300;

/// Work to be done, and its outcome in one sentence.
type Deed = (Option<(RodId, Asked)>, String);

/// The site's side of the commands.
pub struct Obedience {
    key: String,
    site: String,
    store: PathBuf,
    /// Places of an offered configuration, the preferred one first.
    offered: [PathBuf; 2],
    /// Message of the post that was read last.
    read: Option<u64>,
    /// Commands that were not carried out, by reason.
    refused: BTreeMap<String, u64>,
    /// Commit from which on all are to be sent again.
    resend: Option<i64>,
    /// True for a worker of the centre, which sends nothing and has no configuration of its own.
    is_worker: bool,
}

impl Obedience {
    /// Commands signed by `key` for `site`; an offered configuration is kept beside `config`, or beside the store.
    pub fn new(key: &str, site: &str, store: &Path, config: &Path) -> Self {
        let mut name = config.file_name().unwrap_or_default().to_owned();
        name.push(".offered");
        Self {
            key: key.to_owned(),
            site: site.to_owned(),
            store: store.to_owned(),
            offered: [config.with_file_name(&name), store.with_file_name(&name)],
            read: None,
            refused: BTreeMap::new(),
            resend: None,
            is_worker: false,
        }
    }

    /// The same for a site without a computer.
    pub fn of_worker(self) -> Self {
        Self {
            is_worker: true,
            ..self
        }
    }

    /// Commit from which on all are to be sent again, once after a command said so.
    pub fn take_resend(&mut self) -> Option<i64> {
        self.resend.take()
    }

    /// Numbers of commands that were not carried out, by reason.
    pub fn refused(&self) -> &BTreeMap<String, u64> {
        &self.refused
    }

    /// True if a message of the post was not read yet.
    pub fn is_new(&self, sequence: u64) -> bool {
        self.read != Some(sequence)
    }

    /// Tells of an offered configuration while it is there.
    pub fn look(&self, health: &Health) {
        match self.offered.iter().find(|path| path.exists()) {
            None => health.over(Fault::Command, OFFERED),
            Some(_) if health.lasts(Fault::Command, OFFERED) => {}
            Some(path) => {
                let path = path.display();
                let detail = format!(
                    "the centre offers a configuration: {path}; compare it, put it in the place of the present one and reload, or remove it"
                );
                health.hold(Fault::Command, OFFERED, detail);
            }
        }
    }

    /// Reads message `sequence` of the post with the site's open commands, and carries out what is new.
    ///
    /// # Errors
    /// The store cannot be read or written: the message is read again.
    pub fn take(
        &mut self,
        (sequence, payload): (u64, &[u8]),
        epoch: &str,
        reader: &Reader,
        health: &Health,
    ) -> Result<(), StoreError> {
        let open = match command::decode(payload) {
            Ok(open) => open,
            Err(refusal) => {
                self.refuse(&refusal, "a list of commands", health);
                Vec::new()
            }
        };
        self.follow(&open, epoch, reader, health)?;
        self.read = Some(sequence);
        Ok(())
    }

    /// Carries out what is new of a site's open commands.
    ///
    /// # Errors
    /// The store cannot be read or written: they are to be given again.
    pub fn follow(
        &mut self,
        open: &[Signed],
        epoch: &str,
        reader: &Reader,
        health: &Health,
    ) -> Result<(), StoreError> {
        for signed in open {
            match signed.open(&self.key, &self.site) {
                Ok(order) => self.carry_out(&order, epoch, reader, health)?,
                Err(refusal) => self.refuse(&refusal, "a command", health),
            }
        }
        Ok(())
    }

    fn carry_out(
        &mut self,
        order: &Order,
        epoch: &str,
        reader: &Reader,
        health: &Health,
    ) -> Result<(), StoreError> {
        let number = order.number;
        if number <= latest_command(&self.store)? {
            self.count("repeated");
            tracing::info!("command {number} of the centre was answered before: it is not carried out again");
            return Ok(());
        }
        let now = clock::now();
        let done = match order.check(epoch, now.as_nanos()) {
            Ok(()) => self.act(order, reader)?,
            Err(refusal) => Err(refusal),
        };
        let (request, outcome) = match done {
            Ok(deed) => deed,
            Err(refusal) => {
                self.refuse(&refusal, &format!("command {number}"), health);
                (None, format!("refused: {refusal}"))
            }
        };
        let judged = Judged {
            number,
            issued: Timestamp::from_nanos(order.issued_ns),
            about: text::one_line(&format!("{}: {}", order.by, order.action.words())),
            request,
            outcome,
        };
        if put_command(&self.store, &judged, now)? {
            tracing::info!(
                "command {number} of the centre, {}: {}",
                judged.about,
                judged.outcome
            );
        }
        Ok(())
    }

    /// Looks up what an order needs, and what comes of it.
    fn act(&mut self, order: &Order, reader: &Reader) -> Result<Result<Deed, Refusal>, StoreError> {
        let reason = format!("{} (centre, command {})", order.reason, order.number);
        let idle = |what: String| Ok(Err(Refusal::Idle(what)));
        match &order.action {
            Action::Acknowledge { alarm: id } => {
                let Some(alarm) = reader.alarm(id)? else {
                    return idle(format!("there is no alarm {id}"));
                };
                if let Some(time) = alarm.acknowledged {
                    return idle(format!("alarm {id} was acknowledged at {time}"));
                }
                if alarm.is_over() {
                    return idle(format!("alarm {id} is over"));
                }
                let asked = Asked::acknowledge(id, Some(&order.by), Some(&reason));
                Ok(Ok((Some((alarm.rod, asked)), "accepted".to_owned())))
            }
            Action::Rebaseline { rod } => {
                let rod = RodId(rod.clone());
                if !reader.rods()?.contains(&rod) {
                    return idle(format!("there is no rod {rod}"));
                }
                let asked = Asked::rebaseline(Some(&format!("{}: {reason}", order.by)));
                Ok(Ok((Some((rod, asked)), "accepted".to_owned())))
            }
            Action::Resend { .. } if self.is_worker => idle("a worker writes its rows: nothing is sent".to_owned()),
            Action::Configure { .. } if self.is_worker => {
                idle("its configuration is the file that the hub's list names; SIGHUP has the workers read it again".to_owned())
            }
            Action::Resend { from } => {
                let last = reader.latest_change()?;
                if !(1..=last).contains(from) {
                    return idle(format!("the store has commits 1 to {last}"));
                }
                self.resend = Some(*from);
                // This answer is a commit of its own, after all of them.
                Ok(Ok((None, format!("commits {from} to {last} were sent again"))))
            }
            Action::Configure { text } => {
                if let Err(error) = Config::parse(text, "the offered configuration") {
                    let error: String = text::one_line(&error.to_string()).chars().take(LONGEST).collect();
                    return idle(error);
                }
                let mut failure = String::new();
                for path in &self.offered {
                    match write(path, text) {
                        Ok(()) => {
                            let kept = format!("kept as {}: a person there accepts it", path.display());
                            return Ok(Ok((None, kept)));
                        }
                        Err(error) => failure = format!("{}: {error}", path.display()),
                    }
                }
                idle(failure)
            }
        }
    }

    fn refuse(&mut self, refusal: &Refusal, what: &str, health: &Health) {
        self.count(refusal.code());
        health.fault(
            Fault::Command,
            format_args!("{what} of the centre is refused: {refusal}"),
        );
    }

    fn count(&mut self, code: &str) {
        *self.refused.entry(code.to_owned()).or_default() += 1;
    }
}

fn write(path: &Path, text: &str) -> std::io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(text.as_bytes())?;
    file.commit()
}
