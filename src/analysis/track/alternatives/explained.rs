//! Probabilities of the kinds of change, and the measurements that would decide between them.

use super::evidence::{self, Posterior, Seen};
use super::kind::{DECIDED, is_axial};
use super::response::{Alternatives, Curve, Modes};
use super::{Kind, MeanShift, Needed};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// One kind of change.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Weighed {
    /// Kind of the change.
    pub kind: Kind,
    /// ln p(shifts | kind).
    pub log_evidence: f64,
    /// Probability, with equal prior probabilities of all kinds.
    pub probability: f64,
    /// Relative change, if it is this kind: best estimate, 2.5 % and 97.5 % quantile; `None` for several at
    /// once.
    pub change: Option<[f64; 3]>,
}

/// The kinds of change that may have moved the modes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Explained {
    /// Mode orders, from 1.
    pub orders: Vec<usize>,
    /// Number of records averaged.
    pub records: usize,
    /// True if the frequencies fell, on average over the modes.
    pub fell: bool,
    /// The kinds, most probable first.
    pub kinds: Vec<Weighed>,
    /// Measurements that would decide for or against the axial force; empty if decided already, or if no
    /// measurement considered would decide.
    pub needed: Vec<Needed>,
}

impl Alternatives {
    /// Weighs the kinds of change against each other; `None` without modes, or with an invalid covariance.
    pub fn explain(&self, shift: &MeanShift) -> Option<Explained> {
        let seen = Seen {
            orders: shift.orders.clone(),
            shift: shift.shift.clone(),
            covariance: &shift.falling + &shift.fixed,
        };
        let found = self.weigh(&seen, 1)?;
        let kinds = found
            .iter()
            .map(|one| Weighed {
                kind: one.kind,
                log_evidence: one.log_evidence,
                probability: one.probability,
                change: one.posterior.as_ref().map(|posterior| {
                    let size = posterior.size();
                    [size.mean, size.q025, size.q975].map(|size| one.kind.ratio(size) - 1.0)
                }),
            })
            .collect();
        let mut explained = Explained {
            orders: shift.orders.clone(),
            records: shift.records,
            fell: shift.shift.sum() < 0.0,
            kinds,
            needed: Vec::new(),
        };
        if explained.is_axial().is_none() {
            let force = found.iter().find(|one| one.kind == Kind::Force);
            let rival = found
                .iter()
                .find(|one| one.kind != Kind::Force && one.posterior.is_some());
            let expected: Vec<Modes> = [force, rival]
                .into_iter()
                .flatten()
                .filter_map(|one| Some(one.posterior.as_ref()?.expected(&self.curves_of(one.kind))))
                .collect();
            explained.needed = self.needed(shift, &expected);
        }
        Some(explained)
    }

    fn curves_of(&self, kind: Kind) -> Vec<&Curve> {
        self.curves.iter().filter(|curve| curve.kind == kind).collect()
    }

    /// Kinds by probability, from every `stride`-th particle; `None` without modes, or with an invalid
    /// covariance.
    pub(super) fn weigh(&self, seen: &Seen, stride: usize) -> Option<Vec<Candidate>> {
        if seen.orders.is_empty() {
            return None;
        }
        let mut found = Vec::with_capacity(Kind::ALL.len());
        for kind in Kind::ALL {
            let curves = self.curves_of(kind);
            let (posterior, log_evidence) = if curves.is_empty() {
                (None, evidence::of_free_modes(seen)?)
            } else {
                let posterior = evidence::of(self, &curves, seen, stride)?;
                let log_evidence = posterior.log_evidence;
                (Some(posterior), log_evidence)
            };
            found.push(Candidate {
                kind,
                posterior,
                log_evidence,
                probability: 0.0,
            });
        }
        found.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
        let most = found.first()?.log_evidence;
        let sum: f64 = found.iter().map(|one| libm::exp(one.log_evidence - most)).sum();
        for one in &mut found {
            one.probability = libm::exp(one.log_evidence - most) / sum;
        }
        Some(found)
    }
}

/// One kind of change while it is weighed.
pub(super) struct Candidate {
    pub kind: Kind,
    /// Posterior of its size; `None` for independently moving modes.
    posterior: Option<Posterior>,
    log_evidence: f64,
    pub probability: f64,
}

impl Explained {
    /// Decision that the axial force and nothing else changed, or that it did not, if the odds are `kind::DECIDED` or more.
    pub fn is_axial(&self) -> Option<bool> {
        is_axial(self.probability(Kind::Force))
    }

    /// Probability of one kind.
    pub fn probability(&self, kind: Kind) -> f64 {
        self.kinds
            .iter()
            .find(|one| one.kind == kind)
            .map_or(0.0, |one| one.probability)
    }

    /// One sentence for people, without a full stop.
    pub fn sentence(&self) -> String {
        let Some(first) = self.kinds.first() else {
            return String::new();
        };
        let went = if self.fell { "fell" } else { "rose" };
        let force = self.probability(Kind::Force);
        let is_axial = self.is_axial();
        if let (Some(true), Some(change)) = (is_axial, first.change) {
            return format!("the axial force {} ({})", verb(change), self.certainty());
        }
        let mut text = match first.change {
            Some(_) => format!("the frequencies {went} as {} would", told(first)),
            None => format!(
                "the frequencies {went} as no single change of force, supports, mass, modulus or section makes them: several \
                 changes together, a local mass, or an interfering line"
            ),
        };
        self.add_rivals(&mut text, first);
        if is_axial == Some(false) {
            let odds = odds((1.0 - force) / force.max(f64::MIN_POSITIVE));
            let _ = write!(
                text,
                "; not the axial force alone (odds {odds} against it; {})",
                self.over()
            );
        } else {
            self.add_needed(&mut text);
        }
        text
    }

    /// Odds for the axial force, with the data behind them.
    pub fn certainty(&self) -> String {
        let force = self.probability(Kind::Force);
        let odds = odds(force / (1.0 - force).max(f64::MIN_POSITIVE));
        format!("odds {odds} against every other change weighed; {}", self.over())
    }

    /// The explanations besides the axial force, as an addition to a sentence about it, without a full stop.
    pub fn rivals(&self) -> String {
        let Some(force) = self.kinds.iter().find(|one| one.kind == Kind::Force) else {
            return String::new();
        };
        let mut text = "the axial force is one explanation".to_owned();
        self.add_rivals(&mut text, force);
        self.add_needed(&mut text);
        text
    }

    /// The kinds that are not much less probable than `one`.
    fn add_rivals(&self, text: &mut String, one: &Weighed) {
        for other in self.kinds.iter().filter(|other| other.kind != one.kind) {
            let ratio = one.probability / other.probability.max(f64::MIN_POSITIVE);
            if ratio > DECIDED {
                break;
            }
            let _ = if ratio > 1.5 {
                write!(
                    text,
                    "; {} explains them, too (odds {} against it)",
                    told(other),
                    odds(ratio)
                )
            } else if ratio * 1.5 < 1.0 {
                write!(
                    text,
                    "; {} explains them better (odds {} for it)",
                    told(other),
                    odds(ratio.recip())
                )
            } else {
                write!(text, "; {} explains them as well", told(other))
            };
        }
    }

    fn add_needed(&self, text: &mut String) {
        let _ = write!(text, "; these cannot be told apart with {}", self.over());
        let needed: Vec<String> = self
            .needed
            .iter()
            .map(|needed| match needed {
                Needed::Records(count) => format!("about {}", counted(*count, "more record")),
                Needed::Modes(orders) => modes(orders),
            })
            .collect();
        if !needed.is_empty() {
            let _ = write!(
                text,
                "; {} would decide whether it is the force",
                needed.join(", or ")
            );
        }
    }

    /// Modes and number of records behind the odds.
    fn over(&self) -> String {
        format!("{}, {}", modes(&self.orders), counted(self.records, "record"))
    }
}

/// `4:1`.
fn odds(ratio: f64) -> String {
    if ratio > 1000.0 {
        "above 1000:1".to_owned()
    } else {
        format!("{ratio:.0}:1")
    }
}

/// Sentence about a change that may have moved the frequencies.
fn told(one: &Weighed) -> String {
    match one.change {
        Some(change) => format!("a change of {} by {}", one.kind.words(), percent(change)),
        None => "a change of another kind".to_owned(),
    }
}

/// `fell by 2.9 % (2.4 to 3.4 %)`.
fn verb([best, low, high]: [f64; 3]) -> String {
    let went = if best < 0.0 { "fell" } else { "rose" };
    if low.signum() == high.signum() {
        let (near, far) = (low.abs().min(high.abs()), low.abs().max(high.abs()));
        format!(
            "{went} by {} % ({} to {} %)",
            digits(100.0 * best.abs()),
            digits(100.0 * near),
            digits(100.0 * far)
        )
    } else {
        format!("{went} by {}", percent([best, low, high]))
    }
}

/// `-2.9 % (-3.4 to -2.4 %)`.
fn percent(change: [f64; 3]) -> String {
    let [best, low, high] = change.map(|change| {
        let text = digits(100.0 * change.abs());
        let sign = if change < 0.0 { "-" } else { "+" };
        format!("{sign}{text}")
    });
    format!("{best} % ({low} to {high} %)")
}

/// Two significant digits or so.
fn digits(value: f64) -> String {
    let places = if value >= 9.95 {
        0
    } else if value >= 0.995 {
        1
    } else {
        2
    };
    format!("{value:.places$}")
}

fn modes(orders: &[usize]) -> String {
    let list: Vec<String> = orders.iter().map(ToString::to_string).collect();
    match list.split_last() {
        None => String::new(),
        Some((only, [])) => format!("mode {only}"),
        Some((last, rest)) => format!("modes {} and {last}", rest.join(", ")),
    }
}

fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}
