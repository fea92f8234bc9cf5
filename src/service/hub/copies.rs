//! Pages of each site out of the centre's rows: the page and API of a daemon over a copy that follows the centre.
//!
//! A copy is made when its page is asked for, in a folder of the hub's own, and goes when nobody has asked for an hour. It has the
//! records of the last 400 days, and all periods and alarms.

use super::copy::{CopyError, SiteCopy};
use super::scratch::Scratch;
use super::tables::month_of;
use crate::config::HubConfig;
use crate::service::http::{self, Access, Api, Shown};
use crate::site::clock;
use axum::Router;
use axum::extract::Request;
use axum::http::{StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use hyper::service::Service;
use hyper::upgrade::OnUpgrade;
use hyper_util::service::TowerToHyperService;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Most copies at once.
const MOST: usize = 8;
/// Time after which a copy that nobody asks for goes.
const UNASKED: Duration = Duration::from_secs(3600);
/// Interval at which a copy is brought up to date.
const RENEW: Duration = Duration::from_secs(2);
/// Age of the oldest records of a copy \[ns\].
const SHOWN_NS: i64 = 400 * 86_400 * 1_000_000_000;

/// Copies of sites whose pages were asked for.
pub struct Copies {
    config: Arc<HubConfig>,
    access: Access,
    folder: Scratch,
    open: Mutex<BTreeMap<String, Shelf>>,
}

/// One copy with its page.
struct Shelf {
    pages: TowerToHyperService<Router>,
    state: Arc<Mutex<State>>,
    asked: Instant,
    /// Ends the copy when dropped or set.
    stop: watch::Sender<bool>,
}

/// State of a copy.
#[derive(Debug, Clone, PartialEq)]
enum State {
    /// Its first rows are being read.
    Reading,
    /// It has what the centre had a moment ago.
    Ready,
    /// It is no longer brought up to date, for this reason.
    Failed(String),
}

impl Copies {
    /// Copies in a folder of their own.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub fn new(config: Arc<HubConfig>, access: Access) -> io::Result<Arc<Self>> {
        Ok(Arc::new(Self {
            config,
            access,
            folder: Scratch::new()?,
            open: Mutex::default(),
        }))
    }

    /// Answers a request below `/sites/SITE/`.
    pub async fn answer(self: Arc<Self>, site: &str, mut request: Request) -> Response {
        if self.config.site(site).is_none() {
            return (StatusCode::NOT_FOUND, "there is no such site on the list\n").into_response();
        }
        // As it came: names of rods stay encoded.
        let whole = request.uri().path_and_query().map_or("", |path| path.as_str());
        let of_site = whole.strip_prefix("/sites/").unwrap_or_default();
        let below = of_site.find('/').map_or("/", |at| &of_site[at..]);
        let Ok(uri) = below.parse::<Uri>() else {
            return StatusCode::BAD_REQUEST.into_response();
        };
        let (pages, state) = self.shelf(site);
        // Documents and scripts are there at once, and ask for the answers until there are some.
        if uri.path().starts_with("/api/") {
            let why = match state {
                State::Ready => None,
                State::Reading => Some(format!("the centre's rows of {site} are being read")),
                State::Failed(why) => Some(why),
            };
            if let Some(why) = why {
                let body = serde_json::json!({ "error": why }).to_string() + "\n";
                let headers = [
                    (header::CONTENT_TYPE, "application/json"),
                    (header::RETRY_AFTER, "1"),
                ];
                return (StatusCode::SERVICE_UNAVAILABLE, headers, body).into_response();
            }
        }
        *request.uri_mut() = uri;
        // The parameters that the outer routes found would count among those of the page's; a page of signals needs its upgrade.
        let upgrade = request.extensions_mut().remove::<OnUpgrade>();
        request.extensions_mut().clear();
        if let Some(upgrade) = upgrade {
            request.extensions_mut().insert(upgrade);
        }
        match pages.call(request).await {
            Ok(response) => response,
            Err(never) => match never {},
        }
    }

    /// The page of a site and the state of its copy, which is begun if there is none.
    fn shelf(&self, site: &str) -> (TowerToHyperService<Router>, State) {
        let mut open = self.lock();
        open.retain(|_, shelf| shelf.asked.elapsed() < UNASKED);
        if let Some(shelf) = open.get_mut(site) {
            shelf.asked = Instant::now();
            let state = lock(&shelf.state).clone();
            let found = (shelf.pages.clone(), state.clone());
            if matches!(state, State::Failed(_)) {
                // The next question begins anew.
                open.remove(site);
            }
            return found;
        }
        while open.len() >= MOST {
            let oldest = open.iter().min_by_key(|(_, shelf)| shelf.asked);
            let Some(oldest) = oldest.map(|(site, _)| site.clone()) else {
                break;
            };
            open.remove(&oldest);
        }
        let shelf = self.begin(site);
        let found = (shelf.pages.clone(), lock(&shelf.state).clone());
        open.insert(site.to_owned(), shelf);
        found
    }

    fn begin(&self, site: &str) -> Shelf {
        let (stop, stopped) = watch::channel(false);
        let state = Arc::new(Mutex::new(State::Reading));
        let path = self
            .folder
            .path()
            .join(format!("{site}-{}.db", clock::now().as_nanos()));
        let shown = Shown::new(&path);
        let name = site.to_owned();
        let refused = move |_, _| {
            Err(format!(
                "acknowledge it at the centre: `tirante hub command {name} acknowledge ALARM --by NAME --reason TEXT`"
            ))
        };
        let api = Api::new(Arc::clone(&shown), self.access.clone(), refused, stopped.clone());
        tokio::spawn(shown.watch(stopped.clone()));
        let work = Work {
            config: Arc::clone(&self.config),
            site: site.to_owned(),
            path,
            state: Arc::clone(&state),
            stopped,
        };
        let spawned = thread::Builder::new()
            .name(format!("copy {site}"))
            .spawn(move || work.run());
        if let Err(error) = spawned {
            *lock(&state) = State::Failed(format!("no thread for the copy of {site}: {error}"));
        }
        Shelf {
            pages: TowerToHyperService::new(http::routes(None, Some(api))),
            state,
            asked: Instant::now(),
            stop,
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Shelf>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Shelf {
    fn drop(&mut self) {
        self.stop.send_replace(true);
    }
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread that keeps a copy.
struct Work {
    config: Arc<HubConfig>,
    site: String,
    path: PathBuf,
    state: Arc<Mutex<State>>,
    stopped: watch::Receiver<bool>,
}

impl Work {
    fn run(self) {
        if let Err(error) = self.follow() {
            *lock(&self.state) = State::Failed(error.to_string());
        }
        for suffix in ["", "-wal", "-shm", ".lock"] {
            let mut path = self.path.clone().into_os_string();
            path.push(suffix);
            let _ = fs::remove_file(path);
        }
    }

    fn is_stopped(&self) -> bool {
        *self.stopped.borrow()
    }

    fn follow(&self) -> Result<(), CopyError> {
        let mut centre = super::beside(&self.config.storage)?;
        let from = month_of(Some(clock::now().as_nanos() - SHOWN_NS));
        let mut copy = SiteCopy::begin(&mut centre, &self.site, None, Some(from), &self.path)?;
        while !self.is_stopped() {
            copy.renew(&mut centre)?;
            *lock(&self.state) = State::Ready;
            let until = Instant::now() + RENEW;
            while Instant::now() < until && !self.is_stopped() {
                thread::sleep(Duration::from_millis(100));
            }
        }
        Ok(())
    }
}
