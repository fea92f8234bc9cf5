//! Commands of the centre to a site: signed by a person's key, read from the post, judged here.
//!
//! The post holds, as one message, the commands of a site that are not answered yet. Who breaks the post can withhold and repeat
//! them, and cannot make, change, or move one to another site.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nkeys::{KeyPair, KeyPairType};
use serde::{Deserialize, Serialize};

/// Stream with the open commands of each site.
pub const STREAM: &str = "TIRANTE_CMD";
/// Subject of a site, without its name.
pub const SUBJECT: &str = "tirante.v1.cmd";

/// Text in front of what is signed: a signature of anything else is none of a command.
const DOMAIN: &str = "tirante command 1\n";
/// Largest lead of the sender's clock \[ns\].
const AHEAD_NS: i64 = 600_000_000_000;
/// Most commands read at once.
const MOST: usize = 200;

/// An action at a site.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// Acknowledge an alarm.
    Acknowledge {
        /// Id of the alarm.
        alarm: String,
    },
    /// Learn a new baseline of a rod.
    Rebaseline {
        /// Id of the rod.
        rod: String,
    },
    /// Keep a configuration beside the site's own, for a person there to accept.
    Configure {
        /// The configuration.
        text: String,
    },
    /// Send commits again that the post has lost.
    Resend {
        /// First of them.
        from: i64,
    },
}

impl Action {
    /// The action in a few words.
    pub fn words(&self) -> String {
        match self {
            Self::Acknowledge { alarm } => format!("acknowledge {alarm}"),
            Self::Rebaseline { rod } => format!("rebaseline {rod}"),
            Self::Configure { text } => format!("configure ({} bytes)", text.len()),
            Self::Resend { from } => format!("resend {from}"),
        }
    }
}

/// A command, as it is signed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Order {
    /// Name of the site.
    pub site: String,
    /// Id of the site's store.
    pub epoch: String,
    /// Number, larger than that of every command of the site before.
    pub number: i64,
    /// Time at which it was given \[ns since 1970\].
    pub issued_ns: i64,
    /// Time after which it is not carried out \[ns since 1970\].
    pub expires_ns: i64,
    /// Name of the person.
    pub by: String,
    /// Reason in the person's words.
    pub reason: String,
    /// Action.
    pub action: Action,
}

/// A command with its signature.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signed {
    /// The order as JSON, byte for byte as it was signed.
    pub text: String,
    /// Ed25519 signature in base64.
    pub signature: String,
}

/// Reason why a command is not carried out.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Not signed by the key that the site knows, changed since, or no command at all.
    #[error("forged: it is not signed by the key of `command_key`, or was changed since")]
    Forged,
    /// It is another site's.
    #[error("other-site: command {number} is for site {site}")]
    OtherSite {
        /// Its number.
        number: i64,
        /// Name of that site.
        site: String,
    },
    /// The time in which it holds is over.
    #[error("expired")]
    Expired,
    /// It comes from the future: one of two clocks is wrong.
    #[error("clock: it was given after now by the clock of this site")]
    Clock,
    /// The store it was given for is not there any more.
    #[error("other-store: it was given for store {0}")]
    OtherStore(String),
    /// There is no such alarm or rod, or nothing to do.
    #[error("{0}")]
    Idle(String),
}

impl Refusal {
    /// The reason in one word, for counts.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Forged => "forged",
            Self::OtherSite { .. } => "other-site",
            Self::Expired => "expired",
            Self::Clock => "clock",
            Self::OtherStore(_) => "other-store",
            Self::Idle(_) => "idle",
        }
    }
}

impl Order {
    /// Signs it with a seed.
    ///
    /// # Errors
    /// The seed is none of a key of commands.
    pub fn sign(&self, seed: &str) -> Result<Signed, String> {
        let pair = KeyPair::from_seed(seed.trim()).map_err(|error| error.to_string())?;
        if pair.key_pair_type() != KeyPairType::Operator {
            return Err(
                "it is a login and no key of commands: draw one with `tirante hub key --commands`".to_owned(),
            );
        }
        let text = serde_json::to_string(self).map_err(|error| error.to_string())?;
        let signature = pair
            .sign(format!("{DOMAIN}{text}").as_bytes())
            .map_err(|error| error.to_string())?;
        Ok(Signed {
            text,
            signature: STANDARD.encode(signature),
        })
    }

    /// Checks that it holds now, for a site and its store.
    ///
    /// # Errors
    /// It does not.
    pub fn check(&self, epoch: &str, now_ns: i64) -> Result<(), Refusal> {
        if now_ns > self.expires_ns {
            Err(Refusal::Expired)
        } else if self.issued_ns.saturating_sub(now_ns) > AHEAD_NS {
            Err(Refusal::Clock)
        } else if self.epoch != epoch {
            Err(Refusal::OtherStore(self.epoch.clone()))
        } else {
            Ok(())
        }
    }
}

impl Signed {
    /// The order, if `key` has signed it for `site`.
    ///
    /// # Errors
    /// It is forged, or another site's.
    pub fn open(&self, key: &str, site: &str) -> Result<Order, Refusal> {
        let signature = STANDARD.decode(&self.signature).map_err(|_| Refusal::Forged)?;
        KeyPair::from_public_key(key)
            .and_then(|pair| pair.verify(format!("{DOMAIN}{}", self.text).as_bytes(), &signature))
            .map_err(|_| Refusal::Forged)?;
        let order: Order = serde_json::from_str(&self.text).map_err(|_| Refusal::Forged)?;
        if order.site != site || order.number <= 0 {
            return Err(Refusal::OtherSite {
                number: order.number,
                site: order.site,
            });
        }
        Ok(order)
    }
}

/// Content of the message with a site's open commands.
///
/// # Errors
/// It cannot be written as JSON.
pub fn encode(open: &[Signed]) -> Result<Vec<u8>, serde_json::Error> {
    serde_json::to_vec(open)
}

/// Commands of a message, at most two hundred.
///
/// # Errors
/// It is no list of commands.
pub fn decode(payload: &[u8]) -> Result<Vec<Signed>, Refusal> {
    let mut open: Vec<Signed> = serde_json::from_slice(payload).map_err(|_| Refusal::Forged)?;
    open.truncate(MOST);
    Ok(open)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order() -> Order {
        Order {
            site: "todi".to_owned(),
            epoch: "00ff".to_owned(),
            number: 7,
            issued_ns: 1_000,
            expires_ns: 2_000,
            by: "M. Rossi".to_owned(),
            reason: "wedge inspected".to_owned(),
            action: Action::Acknowledge {
                alarm: "5f1d".to_owned(),
            },
        }
    }

    #[test]
    fn what_was_signed_is_read_and_whatever_was_changed_is_not() {
        let pair = KeyPair::new_operator();
        let (key, seed) = (pair.public_key(), pair.seed().unwrap());
        let signed = order().sign(&seed).unwrap();
        assert_eq!(signed.open(&key, "todi"), Ok(order()));
        let sent = encode(std::slice::from_ref(&signed)).unwrap();
        assert_eq!(decode(&sent), Ok(vec![signed.clone()]));
        // Each byte of the text, and the whole signature, are held.
        for place in 0..signed.text.len() {
            let mut bytes = signed.text.clone().into_bytes();
            bytes[place] ^= 1;
            if let Ok(text) = String::from_utf8(bytes) {
                let changed = Signed {
                    text,
                    ..signed.clone()
                };
                assert_eq!(changed.open(&key, "todi"), Err(Refusal::Forged), "byte {place}");
            }
        }
        let other = KeyPair::new_operator();
        assert_eq!(signed.open(&other.public_key(), "todi"), Err(Refusal::Forged));
        for signature in ["", "x", "AAAA"] {
            let forged = Signed {
                signature: signature.to_owned(),
                ..signed.clone()
            };
            assert_eq!(forged.open(&key, "todi"), Err(Refusal::Forged));
        }
        let moved = signed.open(&key, "gubbio");
        assert_eq!(moved.unwrap_err().code(), "other-site");
        assert!(decode(b"junk").is_err());
    }

    #[test]
    fn a_login_signs_no_command_and_a_bare_signature_is_none() {
        let login = KeyPair::new_user();
        assert!(order().sign(&login.seed().unwrap()).is_err());
        // A server that makes a client sign its text as a nonce gets no command.
        let pair = KeyPair::new_operator();
        let text = serde_json::to_string(&order()).unwrap();
        let signature = STANDARD.encode(pair.sign(text.as_bytes()).unwrap());
        let bare = Signed { text, signature };
        assert_eq!(bare.open(&pair.public_key(), "todi"), Err(Refusal::Forged));
    }

    #[test]
    fn an_order_holds_for_its_time_and_its_store() {
        let order = order();
        assert_eq!(order.check("00ff", 2_000), Ok(()));
        assert_eq!(order.check("00ff", 2_001), Err(Refusal::Expired));
        assert_eq!(order.check("00ff", 1_000 - AHEAD_NS), Ok(()));
        assert_eq!(order.check("00ff", 999 - AHEAD_NS), Err(Refusal::Clock));
        assert_eq!(order.check("00fe", 1_500).unwrap_err().code(), "other-store");
    }
}
