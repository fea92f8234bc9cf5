//! Sinks of a daemon whose store is not open yet: told past it what lasts, and why a start failed.

use super::pending;
use crate::config::Config;
use crate::config::settings::alert::SinkSettings;
use crate::service::alert::{Conditions, Couriers};
use crate::service::telemetry::Telemetry;
use crate::site::clock;
use crate::site::store::{self, ConditionEvent, StoreError};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// A daemon before it has its store.
pub struct Unopened {
    sinks: Vec<SinkSettings>,
    site: String,
    store: PathBuf,
    telemetry: Telemetry,
    conditions: Conditions,
    /// Started with the first message: most starts have none.
    couriers: Option<Couriers>,
    /// Begins told whose end was not.
    told: Vec<ConditionEvent>,
}

impl Unopened {
    /// Watches over the start of a daemon, and goes on with what the one before told past the store.
    pub fn new(config: &Config, telemetry: &Telemetry) -> Self {
        let store = config.store.path.clone().unwrap_or_default();
        let told = pending::begins(&store::left(&store));
        let settle = Duration::from_secs_f64(config.alert.settle_s);
        Self {
            sinks: config.sinks.clone(),
            site: config.site.clone(),
            store,
            telemetry: telemetry.clone(),
            conditions: Conditions::new(settle, told.clone()),
            couriers: None,
            told,
        }
    }

    /// Tells what begins and ends to last; called every second.
    pub fn look(&mut self) {
        let lasting = self.telemetry.health.conditions();
        for notice in self.conditions.look(&lasting, Instant::now(), clock::now()) {
            self.couriers().tell(&notice);
            self.told.retain(|begun| begun.condition != notice.condition);
            if notice.is_raised {
                self.told.push(notice);
            }
        }
    }

    /// Tells every sink why the start failed; not that another process has the store, which is at work.
    pub fn tell_end(&mut self, error: &anyhow::Error) {
        let is_held = |cause: &(dyn std::error::Error + 'static)| {
            matches!(cause.downcast_ref(), Some(StoreError::Held { .. }))
        };
        if !self.sinks.is_empty() && !error.chain().any(is_held) {
            self.couriers().tell_end(&format!("{error:#}"));
        }
    }

    /// Leaves to the next daemon what was told: this one is stopped before it has its store.
    pub fn leave(&self) {
        let line = pending::line(&self.told);
        if line != store::left(&self.store)
            && let Some(reserved) = store::reserve(&self.store)
        {
            reserved.tell(&line, "");
        }
    }

    /// Begins that were told and have no end.
    pub fn told(&self) -> Vec<ConditionEvent> {
        self.told.clone()
    }

    fn couriers(&mut self) -> &Couriers {
        let Self {
            sinks,
            site,
            telemetry,
            couriers,
            ..
        } = self;
        couriers.get_or_insert_with(|| Couriers::start_past_the_store(sinks, site, telemetry.clone()))
    }
}
