//! Names and validity of a certificate, and what its holder may send.

use super::server::TopicSet;
use crate::analysis::signal::record::Timestamp;
use crate::config::settings::ingest::BoundCertificate;
use std::sync::Arc;
use tokio_rustls::rustls::pki_types::CertificateDer;
use x509_parser::prelude::{FromDer, GeneralName, X509Certificate};

/// Time before the end of a certificate from which it is reported \[s\].
const NEAR_S: i64 = 30 * 86_400;

/// Time for which a certificate, or a chain of them, is valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Validity {
    /// Time before which it is not valid \[s since 1970\].
    pub begins_s: i64,
    /// Time after which it is not valid \[s since 1970\].
    pub ends_s: i64,
}

impl Validity {
    /// Clause about a certificate that is not valid, or only for less than thirty days more.
    pub fn warning(self, now_s: i64) -> Option<String> {
        let time = |s: i64| Timestamp::from_nanos(s.saturating_mul(1_000_000_000));
        let left_s = self.ends_s.saturating_sub(now_s);
        if self.is_early(now_s) {
            Some(format!(
                "is not valid before {} (this machine's clock says {}; is it right?)",
                time(self.begins_s),
                time(now_s)
            ))
        } else if left_s < 0 {
            Some(format!("ended on {}", time(self.ends_s)))
        } else if left_s < NEAR_S {
            Some(format!(
                "ends on {}, in {} days",
                time(self.ends_s),
                left_s / 86_400
            ))
        } else {
            None
        }
    }

    /// True before its begin.
    pub fn is_early(self, now_s: i64) -> bool {
        now_s < self.begins_s
    }

    /// True if it is valid.
    pub fn holds(self, now_s: i64) -> bool {
        (self.begins_s..=self.ends_s).contains(&now_s)
    }
}

/// Names and validity of a certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Facts {
    /// Common name and DNS names of the holder.
    pub names: Vec<String>,
    /// Time for which it is valid.
    pub valid: Validity,
    /// False if its extended key usage is given and has no server authentication: every client would turn away.
    pub may_serve: bool,
}

impl Facts {
    /// Reads a certificate.
    ///
    /// # Errors
    /// It is no X.509 certificate.
    pub fn of(certificate: &CertificateDer<'_>) -> Result<Self, String> {
        let (_, parsed) = X509Certificate::from_der(certificate)
            .map_err(|fault| format!("holds no readable certificate: {fault}"))?;
        let common = parsed.subject().iter_common_name();
        let mut names: Vec<String> = common
            .filter_map(|name| name.as_str().ok())
            .map(str::to_owned)
            .collect();
        // Two extensions of a kind are refused by the verification before.
        if let Ok(Some(alternative)) = parsed.subject_alternative_name() {
            names.extend(
                alternative
                    .value
                    .general_names
                    .iter()
                    .filter_map(|name| match name {
                        GeneralName::DNSName(name) => Some((*name).to_owned()),
                        _ => None,
                    }),
            );
        }
        let usage = parsed.extended_key_usage().ok().flatten();
        Ok(Self {
            names,
            may_serve: usage.is_none_or(|usage| usage.value.any || usage.value.server_auth),
            valid: Validity {
                begins_s: parsed.validity().not_before.timestamp(),
                ends_s: parsed.validity().not_after.timestamp(),
            },
        })
    }

    /// Name of the holder, for people.
    pub fn name(&self) -> &str {
        self.names
            .first()
            .map_or("a holder without a name", String::as_str)
    }
}

/// What a client may send; the default is everything.
#[derive(Debug, Clone, Default)]
pub(super) struct Rights {
    /// Name of the certificate's holder; `None` without a certificate.
    holder: Option<String>,
    bound: Option<BoundCertificate>,
}

impl Rights {
    /// Rights of the holder of a certificate, by the entries of the configuration.
    ///
    /// # Errors
    /// There are entries, and none is for this certificate.
    pub fn of(facts: &Facts, bound: &[BoundCertificate]) -> Result<Self, String> {
        let holder = Some(facts.name().to_owned());
        if bound.is_empty() {
            return Ok(Self { holder, bound: None });
        }
        let entry = bound
            .iter()
            .find(|entry| facts.names.contains(&entry.certificate));
        let bound = entry.cloned().ok_or_else(|| {
            format!(
                "the certificate of {} has no entry in [[ingest.tls.bound]]",
                facts.name()
            )
        })?;
        Ok(Self {
            holder,
            bound: Some(bound),
        })
    }

    /// Name of the certificate's holder; `None` without a certificate.
    pub fn holder(&self) -> Option<&str> {
        self.holder.as_deref()
    }

    /// Checks the name of a sender.
    ///
    /// # Errors
    /// It is not the holder's.
    pub fn check_sender(&self, sender: &str) -> Result<(), String> {
        match &self.bound {
            Some(bound) if !bound.senders.iter().any(|name| name == sender) => Err(format!(
                "the certificate of {} is not bound to the sender name {sender}",
                bound.certificate
            )),
            _ => Ok(()),
        }
    }

    /// Those of `topics` that the holder may send.
    pub fn narrow(&self, topics: &Arc<TopicSet>) -> Arc<TopicSet> {
        match &self.bound {
            None => Arc::clone(topics),
            Some(bound) => {
                let allowed = topics.iter().filter(|topic| bound.allows(topic));
                Arc::new(allowed.cloned().collect())
            }
        }
    }

    /// Checks topics that were sent and not kept; `all` are those of the rods.
    ///
    /// # Errors
    /// One of them is a rod's, and not the holder's.
    pub fn check_topics<'a>(
        &self,
        mut sent: impl Iterator<Item = &'a str>,
        all: &TopicSet,
    ) -> Result<(), String> {
        let Some(bound) = &self.bound else { return Ok(()) };
        match sent.find(|topic| all.contains(*topic) && !bound.allows(topic)) {
            None => Ok(()),
            Some(topic) => Err(format!(
                "the certificate of {} is not bound to the topic {topic}",
                bound.certificate
            )),
        }
    }
}
