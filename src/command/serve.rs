//! `tirante serve`: serves the page of any store, without a daemon.

use super::BadArguments;
use super::which_store::{WhichStore, ask};
use crate::config::Config;
use crate::config::settings::credential::CredentialPath;
use crate::config::settings::http::{HttpSettings, origin};
use crate::service::http::{self, Access, Api, Shown};
use crate::service::telemetry::Health;
use crate::site::clock;
use crate::site::store::Reader;
use std::net::SocketAddr;
use std::process::ExitCode;
use std::sync::Arc;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

/// Serve a store as a web page.
///
/// It serves until Ctrl-C, with or without a running `replay` or `run`. The page follows new commits: the
/// store is checked four times a second. Foxglove and Lichtblick follow it at ws://ADDRESS:PORT/viewer.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante serve \\
      --store todi.db                      # then open http://127.0.0.1:7417
  tirante serve --config site.toml --listen 127.0.0.1:0
  tirante serve --store todi.db \\
      --token-file token   # with the right to acknowledge alarms

A daemon shows the page itself, at [http] listen. Other machines reach neither
unless a proxy that asks for a password leads there, or --allow-remote is said.")]
pub struct Args {
    /// Store to show.
    #[command(flatten)]
    pub which: WhichStore,

    /// Address and port; port 0 takes a free one, reported on stderr.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7417")]
    pub listen: SocketAddr,

    /// Allow an address that other machines can reach; they can then read everything shown.
    #[arg(long)]
    pub allow_remote: bool,

    /// File with the token for acknowledging alarms; overrides `http.token_file` of the configuration.
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<String>,

    /// Origin of pages that may open the live view; overrides `http.viewer_origins` of the configuration. May
    /// be repeated; desktop viewers are "file://".
    #[arg(long, value_name = "ORIGIN", value_parser = origin)]
    pub viewer_origin: Vec<String>,
}

/// Runs the command.
///
/// # Errors
/// No store, one that cannot be read, or an address that is taken.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if !args.listen.ip().to_canonical().is_loopback() && !args.allow_remote {
        return Err(BadArguments(format!(
            "other machines reach {}: take 127.0.0.1 and a proxy that asks for a password, or say --allow-remote",
            args.listen
        ))
        .into());
    }
    let path = args.which.path()?;
    // An invalid store is reported before anything listens.
    drop(Reader::open(&path)?);
    let configured = match &args.which.config {
        Some(config) => Config::resolve(Some(config), &[])?.http,
        None => HttpSettings::default(),
    };
    let settings = HttpSettings {
        listen: Some(args.listen),
        token_file: args
            .token_file
            .as_deref()
            .map(CredentialPath::new)
            .or(configured.token_file),
        names: configured.names,
        viewer_origins: if args.viewer_origin.is_empty() {
            configured.viewer_origins
        } else {
            args.viewer_origin.clone()
        },
    };
    let access = Access::of(&settings)?;
    let Some(listener) = http::listen(&settings)? else {
        return Ok(ExitCode::SUCCESS);
    };
    let address = listener.local_addr()?;
    let store = path.display().to_string();
    let (stop, stopped) = watch::channel(false);
    let shown = Shown::new(&path);
    let ask = move |rod, what| ask(&path, &[(rod, what)], clock::now()).map_err(|error| format!("{error:#}"));
    let api = Api::new(Arc::clone(&shown), access, ask, stopped.clone());
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let (mut interrupt, mut terminate) =
            (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        // Only now: a signal before would end it as a failure.
        tell!("{store} at http://{address}  (Ctrl-C ends it)");
        tokio::spawn(shown.watch(stopped.clone()));
        tokio::spawn(async move {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
            stop.send_replace(true);
        });
        http::serve(
            listener,
            http::routes(None, Some(api)),
            Arc::new(Health::default()),
            stopped,
        )
        .await
    })?;
    // A question still under way is not waited for.
    runtime.shutdown_background();
    Ok(ExitCode::SUCCESS)
}
