//! Sinks of a daemon whose store is not open yet: told past it what lasts, and why a start failed.

use super::pending;
use crate::config::Config;
use crate::config::settings::alert::SinkSettings;
use crate::service::alert::{Conditions, Couriers};
use crate::service::telemetry::Telemetry;
use crate::site::clock;
use crate::site::store::{self, ConditionEvent, StoreError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A daemon before it has its store.
pub struct Unopened {
    sinks: Vec<SinkSettings>,
    site: String,
    telemetry: Telemetry,
    conditions: Conditions,
    /// Started with the first message: most starts have none.
    couriers: Option<Couriers>,
    /// Begins told, by the daemon before too.
    told: Vec<ConditionEvent>,
    /// These, as they are kept beside the store.
    line: Arc<Mutex<String>>,
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
            telemetry: telemetry.clone(),
            conditions: Conditions::new(settle, told.clone()),
            couriers: None,
            line: Arc::new(Mutex::new(pending::line(&told))),
            told,
        }
    }

    /// Tells what begins to last; called every second. The end is the daemon's to tell, once it has its store.
    pub fn look(&mut self) {
        let lasting = self.telemetry.health.conditions();
        for notice in self.conditions.look(&lasting, Instant::now(), clock::now()) {
            let is_known =
                |begun: &ConditionEvent| begun.fault == notice.fault && begun.about == notice.about;
            if notice.is_raised && !self.told.iter().any(is_known) {
                self.couriers().tell(&notice);
                self.told.push(notice);
                *self.line.lock().unwrap_or_else(PoisonError::into_inner) = pending::line(&self.told);
            }
        }
    }

    /// Line for the next daemon, as it is at any time.
    pub fn pending(&self) -> Arc<Mutex<String>> {
        Arc::clone(&self.line)
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
