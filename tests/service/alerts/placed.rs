//! A sink has its position in the store before anything happens: what comes next is told as it comes, however late its
//! courier starts.

use super::desk::*;
use super::fake::Fake;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tirante::analysis::signal::record::RodId;
use tirante::config::Config;
use tirante::service::daemon::core::Core;
use tirante::service::telemetry::{Fault, Health};
use tirante::site::clock;
use tirante::site::driver::{Done, Job};
use tirante::site::overlap;
use tirante::site::prepared::Generation;
use tirante::site::store::{ConditionEvent, Durability, Store};
use tirante::site::trackers::Site;

fn generation(sinks: &str) -> Arc<Generation> {
    let config = Config::parse(&config_text(sinks), "site.toml").unwrap();
    Arc::new(Generation::prepare(config, |_| |_, _| ()).unwrap())
}

fn hook(id: &str, fake: &Fake) -> String {
    format!(
        "\n[[sink]]\nid = \"{id}\"\nkind = \"webhook\"\nurl = \"{}\"\n",
        fake.url()
    )
}

/// A daemon's core takes up its work, and later a configuration with a further sink; no courier has looked yet when an alarm
/// comes and goes.
#[test]
fn what_happens_before_the_first_look_of_a_courier_is_told() {
    let (folder, fake, added) = (tempfile::tempdir().unwrap(), Fake::new(&[]), Fake::new(&[]));
    let first = generation(&hook("hook", &fake));
    let both = generation(&(hook("hook", &fake) + &hook("added", &added)));
    let store = Store::open(&folder.path().join("site.db"), Durability::Replay).unwrap();
    let site = Site::open(first.track_plans.iter().cloned(), store, first.provenance()).unwrap();
    let flags = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
    let mut core = Core::new(site, first, Arc::default(), flags, Vec::new(), Box::new(|_| ())).unwrap();
    let tick = || Done::Job(Job::Tick { is_caught_up: false });
    core.take(vec![tick()]).unwrap();
    core.take(vec![Done::Job(Job::Reload(Arc::clone(&both))), tick()])
        .unwrap();
    drop(core);

    let desk = Desk::on(folder);
    let expected = [desk.raise(0), desk.clear(0)].map(|alarm| alarm.id);
    let couriers = desk.start(&both.config.sinks);
    for (id, sink) in [("hook", &fake), ("added", &added)] {
        eventually("all is marked", || desk.delivered(id) == Some(2));
        assert_eq!(field(&sink.bodies(), "what"), ["raised", "cleared"], "{id}");
        assert_eq!(field(&sink.bodies(), "alarm"), expected, "{id}");
    }
    couriers.stop();
}

/// Records that overlapped before a restart: of a rod that has one sensor they go on, others have nothing that would end them.
#[test]
fn overlaps_of_rods_that_are_gone_are_over_after_a_restart() {
    let (folder, generation) = (tempfile::tempdir().unwrap(), generation(""));
    let rod = &generation.config.rods[0].analysis.rod;
    let mut store = Store::open(&folder.path().join("site.db"), Durability::Replay).unwrap();
    let abouts = [overlap::about(rod), overlap::about(&RodId("renamed".to_owned()))];
    let notices = abouts
        .clone()
        .map(|about| ConditionEvent::raised("topic", &about, clock::now(), "two sensors"));
    store.watch(&notices, None).unwrap();
    let plans = generation.track_plans.iter().cloned();
    let site = Site::open(plans, store, generation.provenance()).unwrap();
    let flags = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
    let health = Arc::<Health>::default();
    let (own, known) = (Arc::clone(&generation), Arc::clone(&health));
    let _core = Core::new(site, own, known, flags, Vec::new(), Box::new(|_| ())).unwrap();
    assert_eq!(
        abouts.map(|about| health.lasts(Fault::Topic, &about)),
        [true, false]
    );
}
