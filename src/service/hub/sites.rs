//! List of all sites, worst first.

use super::beats::Heard;
use super::centre::{Centre, CentreError};
use super::silence::{CLOCK_OFF_S, heard_ns};
use super::sql::{integer, text};
use crate::config::settings::hub::SiteSettings;
use crate::service::forward::beat::Lasting;
use rusqlite::types::Value;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// What is worst about a site; later is worse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Worst {
    /// All rods are monitored.
    Monitoring,
    /// A rod still learns its baseline.
    Learning,
    /// Nothing has come of the site yet.
    Unheard,
    /// A rod is not monitored.
    NotMonitoring,
    /// Nothing has come for longer than the site's limit.
    Silent,
    /// Messages are parked: what the centre shows is not all there is.
    Parked,
    /// An alarm stands.
    Alarm,
}

impl Worst {
    /// The word in JSON and tables.
    pub fn code(self) -> &'static str {
        match self {
            Self::Monitoring => "monitoring",
            Self::Learning => "learning",
            Self::Unheard => "unheard",
            Self::NotMonitoring => "not-monitoring",
            Self::Silent => "silent",
            Self::Parked => "parked",
            Self::Alarm => "alarm",
        }
    }
}

/// One site of the list.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SiteRow {
    /// Name of the site.
    pub site: String,
    /// What is worst about it.
    pub worst: Worst,
    /// Number of rods by their state.
    pub rods: BTreeMap<String, i64>,
    /// Number of alarms that stand.
    pub alarms: i64,
    /// Begin of the latest record, UTC.
    pub latest_record: Option<String>,
    /// Time of the latest message or heartbeat, UTC.
    pub heard: Option<String>,
    /// Time since the latest message or heartbeat \[s\].
    pub silent_s: Option<f64>,
    /// Time since which nothing is heard of it, UTC, once that is longer than its limit.
    pub silent_since: Option<String>,
    /// Time of the latest heartbeat, UTC.
    pub beat: Option<String>,
    /// Lead of its clock over the post's, where that is more than a minute \[s\].
    pub clock_off_s: Option<f64>,
    /// Version of its program.
    pub version: Option<String>,
    /// State of its daemon in one word.
    pub state: Option<String>,
    /// Time since which nothing is measured or stored there, UTC.
    pub stopped_since: Option<String>,
    /// Conditions of its daemon.
    pub conditions: Vec<Lasting>,
    /// Number of commands that were not carried out since its daemon's start, by reason.
    pub refused: BTreeMap<String, u64>,
    /// Number of commits of the present store that have not come yet.
    pub behind: Option<i64>,
    /// Last commit folded.
    pub through: i64,
    /// Id of the store that sends.
    pub epoch: Option<String>,
    /// Number of stores so far: more than one is a history in segments.
    pub stores: usize,
    /// Begin of the present store's history, UTC.
    pub since: Option<String>,
    /// Fault of its messages.
    pub fault: Option<String>,
    /// The fault in one sentence.
    pub detail: Option<String>,
    /// Number of parked messages.
    pub parked: i64,
    /// Address of its own page.
    pub link: Option<String>,
    /// Worker that has it, of a site without a computer.
    pub worker: Option<String>,
    /// True for a site without a computer that no worker has: nothing of it is monitored.
    pub is_idle: bool,
}

/// Time as text, to the second.
pub(super) fn moment(ns: i64) -> Option<String> {
    let time = jiff::Timestamp::from_nanosecond(i128::from(ns)).ok()?;
    let time = time.round(jiff::Unit::Second).ok()?;
    (ns > 0).then(|| time.to_string())
}

/// All sites on the list, and those that are not but send, worst first.
///
/// # Errors
/// The database refuses.
pub fn list(centre: &mut Centre, listed: &[SiteSettings], now_ns: i64) -> Result<Vec<SiteRow>, CentreError> {
    let known = centre.sites()?;
    let beats = centre.beats()?;
    let current = "\"store\" = (SELECT p.\"store\" FROM \"present\" AS p WHERE p.\"site\" = t.\"site\")";
    let mut rods = BTreeMap::<String, BTreeMap<String, i64>>::new();
    let counted = centre.sql().query(
        &format!("SELECT \"site\", \"state\", count(*) FROM \"rod\" AS t WHERE {current} GROUP BY \"site\", \"state\""),
        &[],
    )?;
    for row in counted {
        let of_site = rods.entry(text(row.first())).or_default();
        of_site.insert(text(row.get(1)), integer(row.get(2)));
    }
    let mut count = |sql: &str| -> Result<BTreeMap<String, Value>, CentreError> {
        let rows = centre.sql().query(sql, &[])?;
        Ok(rows
            .into_iter()
            .filter_map(|row| Some((text(row.first()), row.into_iter().nth(1)?)))
            .collect())
    };
    let alarms = count(&format!(
        "SELECT \"site\", count(*) FROM \"alarm\" AS t WHERE \"stands\" = 1 AND {current} GROUP BY \"site\""
    ))?;
    let parked = count("SELECT \"site\", count(*) FROM \"parked\" GROUP BY \"site\"")?;
    let holders = match listed.iter().any(|site| site.config.is_some()) {
        true => centre.holders()?,
        false => BTreeMap::new(),
    };
    let listed: BTreeMap<&str, &SiteSettings> =
        listed.iter().map(|site| (site.name.as_str(), site)).collect();
    let names: BTreeSet<&str> = listed
        .keys()
        .copied()
        .chain(known.keys().map(String::as_str))
        .collect();
    let mut rows = Vec::new();
    for name in names {
        let settings = listed.get(name);
        let state = known.get(name).cloned().unwrap_or_default();
        let history = state.history();
        let rods = rods.remove(name).unwrap_or_default();
        let heard = beats.get(name);
        let heard_ns = heard_ns(Some(&state), heard);
        let silent_s = (heard_ns > 0).then(|| now_ns.saturating_sub(heard_ns) as f64 * 1e-9);
        let clock_off_s = heard.map(Heard::clock_off_s);
        // What a replaced store said of itself is no news of the present one.
        let of_present =
            heard.filter(|heard| history.is_none_or(|history| history.epoch == heard.beat.epoch));
        let stopped_since = heard.and_then(|heard| heard.beat.stopped_since);
        let alarms = integer(alarms.get(name));
        let parked = integer(parked.get(name));
        let is_silent = settings.is_some_and(|site| silent_s.is_some_and(|silent| silent > site.silent_s));
        let worker = holders.get(name).cloned();
        let is_idle = settings.is_some_and(|site| site.config.is_some()) && worker.is_none();
        let has = |state: &str| rods.contains_key(state);
        let worst = if alarms > 0 || has("alarm") {
            Worst::Alarm
        } else if parked > 0 || state.fault.is_some() {
            Worst::Parked
        } else if is_silent {
            Worst::Silent
        } else if has("not-monitoring") || stopped_since.is_some() || is_idle {
            Worst::NotMonitoring
        } else if history.is_none() {
            Worst::Unheard
        } else if has("learning") {
            Worst::Learning
        } else {
            Worst::Monitoring
        };
        let (fault, detail) = state.fault.clone().unzip();
        rows.push(SiteRow {
            worst,
            rods,
            alarms,
            latest_record: history.and_then(|history| moment(history.latest_ns)),
            heard: moment(heard_ns),
            silent_s,
            silent_since: moment(heard_ns).filter(|_| is_silent),
            beat: heard.and_then(|heard| moment(heard.heard_ns)),
            clock_off_s: clock_off_s.filter(|off_s| off_s.abs() > CLOCK_OFF_S),
            version: heard.map(|heard| heard.beat.version.clone()),
            state: heard.map(|heard| heard.beat.state.clone()),
            stopped_since: stopped_since.map(|since| since.to_string()),
            conditions: heard.map_or_else(Vec::new, |heard| heard.beat.conditions.clone()),
            refused: heard.map_or_else(BTreeMap::new, |heard| heard.beat.refused.clone()),
            behind: of_present.map(|heard| {
                let through = history.map_or(0, |history| history.through);
                heard.beat.through.saturating_sub(through).max(0)
            }),
            through: history.map_or(0, |history| history.through),
            epoch: history.map(|history| history.epoch.clone()),
            stores: state.histories.len(),
            since: history.and_then(|history| moment(history.began_ns)),
            fault,
            detail,
            parked,
            link: settings.and_then(|site| site.link.clone()),
            worker,
            is_idle,
            site: name.to_owned(),
        });
    }
    rows.sort_by(|one, other| {
        other
            .worst
            .cmp(&one.worst)
            .then_with(|| one.site.cmp(&other.site))
    });
    Ok(rows)
}

impl SiteRow {
    /// What its heartbeats, or their silence, tell beside the worst, in sentences.
    pub fn sentences(&self) -> Vec<String> {
        let mut said = Vec::new();
        if let Some(since) = &self.silent_since {
            said.push(format!("silent since {since}"));
        }
        if let Some(since) = &self.stopped_since {
            said.push(format!("monitoring stopped since {since}"));
        }
        if let Some(off_s) = self.clock_off_s {
            said.push(format!("its clock is off by {off_s:+.0} s"));
        }
        if self.is_idle {
            said.push("no worker has it (`tirante work`): nothing of it is monitored".to_owned());
        }
        let lasting = self.conditions.iter();
        said.extend(lasting.map(|one| format!("{} since {}: {}", one.kind, one.since, one.detail)));
        said
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::hub::post::{Post, store};
    use serde_json::Value as Json;

    #[test]
    fn the_description_holds() {
        let mut post = Post::new();
        let message = post.of("todi", &store(), 1, 6);
        post.send(&message);
        let listed = SiteSettings {
            name: "gubbio".to_owned(),
            link: Some("http://gubbio.example.org".to_owned()),
            position: None,
            silent_s: 60.0,
            command_key: None,
            config: None,
        };
        let rows = list(&mut post.centre, &[listed], 1_780_000_000_000_000_000).unwrap();
        assert_eq!(rows.len(), 2);
        let described: Json = serde_json::from_str(include_str!("../../../docs/openapi-hub.json")).unwrap();
        let schema = &described["components"]["schemas"]["SiteRow"];
        let properties = schema["properties"].as_object().unwrap();
        assert_eq!(schema["required"].as_array().unwrap().len(), properties.len());
        for row in rows {
            let row = serde_json::to_value(row).unwrap();
            let row = row.as_object().unwrap();
            assert_eq!(row.len(), properties.len(), "{row:?}");
            for (name, value) in row {
                let kind = match value {
                    Json::Null => "null",
                    Json::Bool(_) => "boolean",
                    Json::Number(number) if number.is_i64() => "integer",
                    Json::Number(_) => "number",
                    Json::String(_) => "string",
                    Json::Array(_) => "array",
                    Json::Object(_) => "object",
                };
                let allowed = &properties.get(name).unwrap_or_else(|| panic!("{name}"))["type"];
                let is_allowed =
                    allowed == kind || allowed.as_array().is_some_and(|all| all.contains(&kind.into()));
                assert!(is_allowed, "{name}: {value}");
            }
        }
        let worst = properties["worst"]["enum"].as_array().unwrap();
        let all = [
            Worst::Monitoring,
            Worst::Learning,
            Worst::Unheard,
            Worst::NotMonitoring,
            Worst::Silent,
            Worst::Parked,
            Worst::Alarm,
        ];
        assert_eq!(*worst, all.map(|one| Json::from(one.code())));
    }
}
