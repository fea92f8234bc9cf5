//! A stream at the post that keeps messages for days: checked, and created where it is missing.

use crate::config::HubConfig;
use crate::config::settings::forward::NatsSettings;
use crate::service::forward::link::{Link, LinkError};
use crate::service::forward::message::LEAST_MESSAGE;
use async_nats::jetstream::ErrorCode;
use async_nats::jetstream::context::{CreateStreamErrorKind, GetStreamErrorKind};
use async_nats::jetstream::stream::{
    Config, DiscardPolicy, PersistenceMode, RetentionPolicy, StorageType, Stream,
};
use std::time::Duration;

/// Largest and smallest stream that is created \[bytes\]; the server sets aside what a stream may hold.
const STREAM_BYTES: (i64, i64) = (16 << 30, 1 << 30);

/// A stream with a subject for each site.
#[derive(Debug, Clone, Copy)]
pub struct Lasting {
    /// Its name.
    pub name: &'static str,
    /// Subject of a site, without its name.
    pub subject: &'static str,
    /// Age at which it drops messages, where it is created.
    pub kept: Duration,
    /// Time for which an id of a message is remembered, so that it is kept once; zero for the server's two minutes.
    pub remembers: Duration,
}

impl Lasting {
    /// The stream, checked; created if it is missing and that is configured.
    ///
    /// # Errors
    /// It is missing or not fit, or the server does not answer.
    pub async fn open(&self, link: &Link, config: &HubConfig) -> Result<Stream, LinkError> {
        let (name, url) = (self.name, config.nats.url());
        let stream = match link.jetstream.get_stream(name).await {
            Ok(stream) => stream,
            Err(error) if matches!(error.kind(), GetStreamErrorKind::JetStream(_)) && config.is_creating => {
                self.created(link, &config.nats).await?
            }
            Err(error) => return Err(link.failed(&format!("the stream {name}"), &error)),
        };
        match self.unfit(&stream.cached_info().config, config.nats.replicas()) {
            Some(wrong) => Err(LinkError::Failed(format!("{url}: the stream {name} {wrong}"))),
            None => Ok(stream),
        }
    }

    /// Creates the stream as large as the server has room for.
    async fn created(&self, link: &Link, nats: &NatsSettings) -> Result<Stream, LinkError> {
        let (name, url) = (self.name, nats.url());
        let mut config = self.wanted(nats.replicas());
        loop {
            let gib = config.max_bytes >> 30;
            let error = match link.jetstream.create_stream(&config).await {
                Ok(stream) => {
                    tracing::info!("{url}: the stream {name} is created: it keeps {gib} GiB");
                    return Ok(stream);
                }
                Err(error) => error,
            };
            let has_no_room = matches!(error.kind(), CreateStreamErrorKind::JetStream(ref said)
                if said.error_code() == ErrorCode::STORAGE_RESOURCES_EXCEEDED);
            if !has_no_room {
                return Err(link.failed(&format!("creating the stream {name}"), &error));
            }
            if config.max_bytes <= STREAM_BYTES.1 {
                return Err(LinkError::Failed(format!(
                    "{url}: the server has no room for a stream of {gib} GiB: free its disk or raise max_file_store in its jetstream section"
                )));
            }
            tracing::warn!("{url}: the server has no room for a stream of {gib} GiB: half of it is tried");
            config.max_bytes /= 2;
        }
    }

    /// The largest stream that is created. It takes messages as large as the server does.
    fn wanted(&self, replicas: usize) -> Config {
        Config {
            name: self.name.to_owned(),
            num_replicas: replicas,
            subjects: vec![format!("{}.*", self.subject)],
            retention: RetentionPolicy::Limits,
            storage: StorageType::File,
            discard: DiscardPolicy::Old,
            max_age: self.kept,
            duplicate_window: self.remembers,
            max_bytes: STREAM_BYTES.0,
            allow_direct: true,
            deny_delete: true,
            deny_purge: true,
            ..Config::default()
        }
    }

    /// Reason why a stream is not fit to keep what the sites send.
    fn unfit(&self, config: &Config, replicas: usize) -> Option<String> {
        let (name, subjects) = (self.name, format!("{}.*", self.subject));
        // An answer without it speaks of one.
        if config.num_replicas.max(1) < replicas {
            return Some(format!(
                "is kept by fewer than {replicas} servers of the cluster: `nats stream edit {name} --replicas {replicas}`"
            ));
        }
        let least_s = Duration::from_secs(7 * 86_400);
        let wrong = if config.storage != StorageType::File {
            "is kept in memory: it needs file storage"
        } else if config.retention != RetentionPolicy::Limits {
            "drops what was read: its retention must be limits"
        } else if config.max_age.is_zero() && config.max_bytes <= 0 {
            "has no limit: give it max_age and max_bytes, or it fills the disk"
        } else if !config.max_age.is_zero() && config.max_age < least_s {
            "drops messages before they are seven days old: raise max_age"
        } else if config.max_messages_per_subject > 0 {
            "keeps some messages of each site alone: unset max_msgs_per_subject"
        } else if config.max_messages > 0 {
            "drops messages by their number: unset max_msgs, and limit it by max_age and max_bytes"
        } else if config.max_message_size > 0 && config.max_message_size < LEAST_MESSAGE {
            "refuses messages of 1 MiB: raise or unset max_msg_size"
        } else if config.allow_rollup {
            "lets a message replace those before it: unset allow_rollup_hdrs"
        } else if config.allow_message_ttl {
            "lets a message end earlier than max_age: unset allow_msg_ttl"
        } else if !config.deny_delete || !config.deny_purge {
            "lets messages be deleted: set deny_delete and deny_purge"
        } else if config.persist_mode == Some(PersistenceMode::Async) {
            "acknowledges before it writes: its persist_mode must be default"
        } else if config.subjects != [subjects.as_str()] {
            return Some(format!(
                "is not that of the sites alone: its subjects must be {subjects}"
            ));
        } else if config.sealed || config.mirror.is_some() || config.sources.is_some() {
            "is a copy or sealed: sites cannot write it"
        } else if !config.allow_direct {
            "does not let a site read its own last message: set allow_direct"
        } else if config.no_ack {
            "does not acknowledge: unset no_ack"
        } else {
            return None;
        };
        Some(wrong.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RESULTS: Lasting = Lasting {
        name: "RESULTS",
        subject: "results",
        kept: Duration::from_secs(90 * 86_400),
        remembers: Duration::ZERO,
    };

    #[test]
    fn the_stream_that_is_created_is_fit_and_laxer_ones_are_not() {
        assert_eq!(RESULTS.unfit(&RESULTS.wanted(3), 3), None);
        assert!(
            RESULTS
                .unfit(&RESULTS.wanted(1), 3)
                .is_some_and(|wrong| wrong.contains("--replicas 3"))
        );
        let laxer: [fn(&mut Config); 15] = [
            |config| config.storage = StorageType::Memory,
            |config| config.retention = RetentionPolicy::WorkQueue,
            |config| (config.max_age, config.max_bytes) = (Duration::ZERO, -1),
            |config| config.max_age = Duration::from_secs(3600),
            |config| config.allow_direct = false,
            |config| config.no_ack = true,
            |config| config.max_messages_per_subject = 1,
            |config| config.max_messages = 1000,
            |config| config.max_message_size = 1 << 16,
            |config| config.allow_rollup = true,
            |config| config.allow_message_ttl = true,
            |config| config.deny_delete = false,
            |config| config.deny_purge = false,
            |config| config.persist_mode = Some(PersistenceMode::Async),
            |config| config.subjects.push("other".to_owned()),
        ];
        for change in laxer {
            let mut config = RESULTS.wanted(1);
            change(&mut config);
            assert!(RESULTS.unfit(&config, 1).is_some(), "{config:?}");
        }
    }
}
