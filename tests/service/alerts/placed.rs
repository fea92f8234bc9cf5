//! A sink has its position in the store before anything happens: what comes next is told as it comes, however late its
//! courier starts.

use super::desk::*;
use super::fake::Fake;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tirante::config::Config;
use tirante::service::daemon::core::Core;
use tirante::site::driver::{Done, Job};
use tirante::site::prepared::Generation;
use tirante::site::store::{Durability, Store};
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
