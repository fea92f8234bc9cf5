//! Commands to the sites, from the database to the post: of each site those that are neither answered nor expired, as one message.

use super::centre::{Centre, CentreError};
use super::sql::{SqlError, integer, text};
use crate::config::HubConfig;
use crate::service::forward::command::{self, Order, STREAM, SUBJECT, Signed};
use crate::service::forward::link::{Link, LinkError};
use crate::site::store::command_id;
use async_nats::jetstream::context::GetStreamErrorKind;
use async_nats::jetstream::stream::{Config, RetentionPolicy, StorageType};
use rusqlite::types::Value;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Duration;

/// Most bytes of the commands in one message; a server takes 1 MiB by default.
const LARGEST: usize = 900 << 10;
/// Age at which the stream drops commands; each has an end of its own.
const KEPT: Duration = Duration::from_secs(90 * 86_400);
/// Longest time for the post to take a message; results wait meanwhile.
const ANSWER: Duration = Duration::from_secs(2);

/// What became of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Not answered yet.
    Pending,
    /// The site will carry it out: a new baseline begins with the rod's next record.
    Accepted,
    /// Done.
    CarriedOut,
    /// Not done, for a reason.
    Refused,
    /// Not done in time.
    Expired,
}

impl State {
    /// The word in JSON and tables.
    pub fn code(self) -> &'static str {
        match self {
            Self::Pending => "pending",
            Self::Accepted => "accepted",
            Self::CarriedOut => "carried-out",
            Self::Refused => "refused",
            Self::Expired => "expired",
        }
    }
}

/// A command with what became of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CommandRow {
    /// Name of the site.
    pub site: String,
    /// Its number.
    pub number: i64,
    /// Time at which it was given, UTC.
    pub issued: Option<String>,
    /// Time after which it is not carried out, UTC.
    pub expires: Option<String>,
    /// Name of the person.
    pub by: String,
    /// Action in a few words.
    pub action: String,
    /// Reason in the person's words.
    pub reason: String,
    /// What became of it.
    pub state: State,
    /// The site's answer in one sentence.
    pub answer: Option<String>,
    /// Time of the answer by the site's clock, UTC.
    pub answered: Option<String>,
}

/// Open commands by site, in order.
type Open = BTreeMap<String, Vec<(i64, Signed)>>;

impl Centre {
    /// Number for the next command of a site. Numbers grow with time, also over a database that was emptied.
    ///
    /// # Errors
    /// The database refuses.
    pub fn next_command(&mut self, site: &str, now_ns: i64) -> Result<i64, CentreError> {
        let rows = self.sql.query(
            "SELECT max(\"number\") FROM \"command\" WHERE \"site\" = $1",
            &[Value::Text(site.to_owned())],
        )?;
        let last = integer(rows.first().and_then(|row| row.first()));
        Ok((now_ns / 1_000_000).max(last + 1))
    }

    /// Keeps a command; the running hub takes it to the post.
    ///
    /// # Errors
    /// Its number is taken, or the database refuses.
    pub fn keep_command(&mut self, order: &Order, signed: &Signed) -> Result<(), CentreError> {
        self.sql.execute(
            "INSERT INTO \"command\" (\"site\", \"number\", \"condition\", \"expires_ns\", \"text\", \"signature\")
             VALUES ($1, $2, $3, $4, $5, $6)",
            &[
                Value::Text(order.site.clone()),
                Value::Integer(order.number),
                Value::Text(command_id(order.number)),
                Value::Integer(order.expires_ns),
                Value::Text(signed.text.clone()),
                Value::Text(signed.signature.clone()),
            ],
        )?;
        Ok(())
    }

    /// Commands that are neither answered nor expired.
    ///
    /// # Errors
    /// The database refuses.
    pub fn open_commands(&mut self, now_ns: i64) -> Result<Open, CentreError> {
        let rows = self.sql.query(
            "SELECT c.\"site\", c.\"number\", c.\"text\", c.\"signature\" FROM \"command\" AS c WHERE c.\"expires_ns\" >= $1
             AND NOT EXISTS (SELECT 1 FROM \"notice\" AS n WHERE n.\"site\" = c.\"site\" AND n.\"condition\" = c.\"condition\")
             ORDER BY c.\"site\", c.\"number\"",
            &[Value::Integer(now_ns)],
        )?;
        let mut open = Open::new();
        for row in rows {
            let signed = Signed {
                text: text(row.get(2)),
                signature: text(row.get(3)),
            };
            let of_site = open.entry(text(row.first())).or_default();
            of_site.push((integer(row.get(1)), signed));
        }
        Ok(open)
    }

    /// All commands, of one site or of all, the latest first.
    ///
    /// # Errors
    /// The database refuses.
    pub fn commands(&mut self, site: Option<&str>, now_ns: i64) -> Result<Vec<CommandRow>, CentreError> {
        let rows = self.sql.query(
            "SELECT c.\"site\", c.\"number\", c.\"text\", n.\"detail\", n.\"time\", n.\"store\" FROM \"command\" AS c
             LEFT JOIN \"notice\" AS n ON n.\"site\" = c.\"site\" AND n.\"condition\" = c.\"condition\"
             WHERE $1 = '' OR c.\"site\" = $1 ORDER BY c.\"number\" DESC, c.\"site\"",
            &[Value::Text(site.unwrap_or_default().to_owned())],
        )?;
        let mut commands = Vec::new();
        for row in rows {
            let site = text(row.first());
            let order: Order = serde_json::from_str(&text(row.get(2))).map_err(|error| {
                SqlError::Refused(format!("command {} of {site}: {error}", integer(row.get(1))))
            })?;
            let answer = Some(text(row.get(3))).filter(|answer| !answer.is_empty());
            let state = match answer.as_deref() {
                None if now_ns > order.expires_ns => State::Expired,
                None => State::Pending,
                Some("refused: expired") => State::Expired,
                Some(answer) if answer.starts_with("refused") => State::Refused,
                Some(answer) => match request_of(answer) {
                    Some(request) if !self.is_applied(&site, integer(row.get(5)), request)? => {
                        State::Accepted
                    }
                    _ => State::CarriedOut,
                },
            };
            commands.push(CommandRow {
                site,
                number: order.number,
                issued: super::sites::moment(order.issued_ns),
                expires: super::sites::moment(order.expires_ns),
                action: order.action.words(),
                by: order.by,
                reason: order.reason,
                state,
                answered: answer.as_ref().map(|_| text(row.get(4))),
                answer,
            });
        }
        Ok(commands)
    }

    /// True if a site has applied a request: it is copied then.
    fn is_applied(&mut self, site: &str, store: i64, request: i64) -> Result<bool, CentreError> {
        let rows = self.sql.query(
            "SELECT count(*) FROM \"request\" WHERE \"site\" = $1 AND \"store\" = $2 AND \"number\" = $3 AND \"applied\" = 1",
            &[
                Value::Text(site.to_owned()),
                Value::Integer(store),
                Value::Integer(request),
            ],
        )?;
        Ok(integer(rows.first().and_then(|row| row.first())) > 0)
    }
}

/// Number of the request that an answer names at its end.
fn request_of(answer: &str) -> Option<i64> {
    let (_, number) = answer.strip_suffix(')')?.rsplit_once("(request ")?;
    number.parse().ok()
}

/// What the post has of the commands.
#[derive(Default)]
pub struct Published {
    /// Numbers of each site's message.
    sites: BTreeMap<String, Vec<i64>>,
    has_stream: bool,
}

impl Published {
    /// Sends the open commands of each site whose list is another one than before.
    ///
    /// # Errors
    /// The post does not take them.
    pub async fn publish(
        &mut self,
        link: &Link,
        mut open: Open,
        config: &HubConfig,
    ) -> Result<(), LinkError> {
        if !self.has_stream {
            match tokio::time::timeout(ANSWER, check(link, config)).await {
                Ok(checked) => checked?,
                Err(elapsed) => return Err(link.failed(&format!("the stream {STREAM}"), &elapsed)),
            }
            self.has_stream = true;
        }
        for site in self.sites.keys() {
            open.entry(site.clone()).or_default();
        }
        for (site, mut commands) in open {
            let mut room = LARGEST;
            commands.retain(|(_, signed)| {
                let size = 2 * signed.text.len() + 256;
                room = room.saturating_sub(size);
                room > 0
            });
            let (numbers, commands): (Vec<i64>, Vec<Signed>) = commands.into_iter().unzip();
            if self.sites.get(&site) == Some(&numbers) {
                continue;
            }
            let subject = format!("{SUBJECT}.{site}");
            let payload = command::encode(&commands).map_err(|error| LinkError::Failed(error.to_string()))?;
            let send = async {
                match link.jetstream.publish(subject.clone(), payload.into()).await {
                    Ok(sent) => sent.await.map(|_| ()),
                    Err(error) => Err(error),
                }
            };
            match tokio::time::timeout(ANSWER, send).await {
                Ok(sent) => sent.map_err(|error| link.failed(&subject, &error))?,
                Err(elapsed) => return Err(link.failed(&subject, &elapsed)),
            }
            self.sites.insert(site, numbers);
        }
        Ok(())
    }
}

/// Creates the stream if it is missing and that is configured, and checks that it keeps the latest list of each site alone.
async fn check(link: &Link, config: &HubConfig) -> Result<(), LinkError> {
    let stream = match link.jetstream.get_stream(STREAM).await {
        Err(error) if matches!(error.kind(), GetStreamErrorKind::JetStream(_)) && config.is_creating => {
            let created = link.jetstream.create_stream(wanted(config.nats.replicas())).await;
            created.map_err(|error| link.failed(&format!("creating the stream {STREAM}"), &error))?
        }
        found => found.map_err(|error| link.failed(&format!("the stream {STREAM}"), &error))?,
    };
    let found = &stream.cached_info().config;
    let replicas = config.nats.replicas();
    let is_fit = found.max_messages_per_subject == 1
        && found.allow_direct
        && found.num_replicas.max(1) >= replicas
        && found.subjects == [format!("{SUBJECT}.*")];
    if is_fit {
        return Ok(());
    }
    let what = format!(
        "the stream {STREAM} is not that of the commands: its subjects must be {SUBJECT}.*, its max_msgs_per_subject 1, its replicas {replicas}, with allow_direct"
    );
    Err(LinkError::Failed(what))
}

/// The stream that the hub creates.
fn wanted(replicas: usize) -> Config {
    Config {
        name: STREAM.to_owned(),
        num_replicas: replicas,
        subjects: vec![format!("{SUBJECT}.*")],
        retention: RetentionPolicy::Limits,
        storage: StorageType::File,
        max_messages_per_subject: 1,
        max_age: KEPT,
        max_bytes: 64 << 20,
        allow_direct: true,
        deny_delete: true,
        deny_purge: true,
        ..Config::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_names_its_request() {
        assert_eq!(request_of("accepted (request 12)"), Some(12));
        for none in [
            "accepted",
            "kept as x (request )",
            "refused: there is no rod (request 3",
        ] {
            assert_eq!(request_of(none), None, "{none}");
        }
    }
}
