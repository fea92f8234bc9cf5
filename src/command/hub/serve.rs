//! `tirante hub`: folds and serves until stopped.

use crate::config::HubConfig;
use crate::service::http::{self, Access};
use crate::service::hub::Hub;
use crate::service::hub::page::Page;
use crate::service::hub::watch::Watch;
use crate::service::telemetry::Health;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

/// Longest time to stop by itself.
const STOP_WITHIN: Duration = Duration::from_secs(5);
/// Conditions that may hold of one site: silence, clock, parked messages.
const CONDITIONS_OF_SITE: usize = 3;

/// Checks everything once, then folds until SIGTERM or SIGINT.
///
/// # Errors
/// Server, stream or database are not fit, or the address is taken.
pub fn run(config: HubConfig) -> anyhow::Result<ExitCode> {
    let room = CONDITIONS_OF_SITE * config.sites.len();
    let (health, stopping) = (Arc::<Health>::default(), Arc::<AtomicBool>::default());
    health.make_room(room);
    let access = Access::of(&config.http)?;
    let listener = http::listen(&config.http)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("io")
        .enable_all()
        .build()?;
    let (stop, stopped) = watch::channel(false);
    let (mut interrupt, mut terminate) = {
        let _entered = runtime.enter();
        (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
    };
    let flag = Arc::clone(&stopping);
    runtime.spawn(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        flag.store(true, Ordering::Relaxed);
        stop.send_replace(true);
        tokio::time::sleep(STOP_WITHIN).await;
        // A database or post that hangs holds the folding. What is not committed is folded at the next start.
        tracing::warn!("the hub ends although the database or the post hangs");
        std::process::exit(0);
    });
    let config = Arc::new(config);
    let hub = Hub::new(&config, &runtime, Arc::clone(&health), stopping);
    // What is not fit is told at once; what fails later is tried again.
    hub.check()?;
    if let Some(listener) = listener {
        tell!("all sites at http://{}", listener.local_addr()?);
        let page = Page::new(Arc::clone(&config), Arc::clone(&health), hub.beat(), &access).routes(access);
        let health = Arc::clone(&health);
        runtime.spawn(async move {
            if let Err(error) = http::serve(listener, page, health, stopped).await {
                tracing::error!("http: {error}");
            }
        });
    }
    runtime.spawn(hub.heard().listen(Arc::clone(&config), Arc::clone(&health)));
    let watch = Watch::start(&config, &health, hub.beat())?;
    tell!("ready: {} sites on the list", config.sites.len());
    hub.run();
    drop(watch);
    runtime.shutdown_background();
    Ok(ExitCode::SUCCESS)
}
