//! Pages of each site out of the centre's rows: the page and API of a daemon over a copy that follows the centre.
//!
//! A copy is made when its API is asked, in a folder of the hub's own, and goes when nobody has asked or listened for an hour. It has
//! the records of the last days (`[copies] days`), and all periods and alarms. Documents and scripts need none.

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
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Most copies at once, those that are being ended among them: each has a thread and a connection to the database.
const MOST: usize = 8;
/// Interval at which a copy that is looked at is brought up to date, and time after which one that nobody asks for goes.
const PACE: (Duration, Duration) = (Duration::from_millis(300), Duration::from_secs(3600));

/// Time without a question after which nobody looks, and by how much the interval is longer then.
const WATCHED: Duration = Duration::from_secs(60);
const UNWATCHED: u32 = 7;

type Pages = TowerToHyperService<Router>;

/// Copies of sites whose pages were asked for.
pub struct Copies {
    config: Arc<HubConfig>,
    access: Access,
    /// Their folder, or the reason why there is none.
    folder: Result<Scratch, String>,
    /// Documents and scripts, the same for every site.
    documents: Pages,
    open: Mutex<BTreeMap<String, Shelf>>,
    /// Held by each thread that keeps a copy.
    at_work: Arc<()>,
    /// As [`PACE`].
    pace: (Duration, Duration),
}

/// One copy with its page.
struct Shelf {
    pages: Pages,
    copy: Arc<Shared>,
    /// Ends the copy when dropped.
    stop: watch::Sender<bool>,
}

/// What a copy's page and its thread share.
struct Shared {
    state: Mutex<State>,
    asked: Mutex<Instant>,
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
    /// Nobody asked for it any more.
    Ended,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn asked(&self) -> MutexGuard<'_, Instant> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Copies {
    /// Copies in the folder of the configuration.
    pub fn new(config: Arc<HubConfig>, access: Access) -> Arc<Self> {
        let below = &config.copies.path;
        let folder = Scratch::new(below).map_err(|error| {
            format!(
                "pages of sites need a folder for copies of their rows, and {} cannot be used ({error}): name another as [copies] path",
                below.display()
            )
        });
        if let Err(why) = &folder {
            tracing::warn!("{why}");
        }
        Arc::new(Self {
            folder,
            config,
            access,
            documents: TowerToHyperService::new(http::documents()),
            open: Mutex::default(),
            at_work: Arc::default(),
            pace: PACE,
        })
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
        let pages = match uri.path() {
            "/assets/place.js" => return place(site),
            path if path.starts_with("/api/") || path == "/viewer" => match self.pages(site) {
                Ok(pages) => pages,
                Err(why) => return later(&why),
            },
            _ => self.documents.clone(),
        };
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

    /// The page of a site whose copy is ready, or the reason why it is not yet; a copy is begun if there is none.
    fn pages(&self, site: &str) -> Result<Pages, String> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|_, shelf| *shelf.copy.state() != State::Ended);
        let reading = || Err(format!("the centre's rows of {site} are being read"));
        if let Some(shelf) = open.get(site) {
            *shelf.copy.asked() = Instant::now();
            let state = shelf.copy.state().clone();
            return match state {
                State::Ready => Ok(shelf.pages.clone()),
                State::Failed(why) => {
                    // The next question begins anew.
                    open.remove(site);
                    Err(why)
                }
                State::Reading | State::Ended => reading(),
            };
        }
        while open.len() >= MOST {
            let longest = open.iter().min_by_key(|(_, shelf)| *shelf.copy.asked());
            let Some(longest) = longest.map(|(site, _)| site.clone()) else {
                break;
            };
            open.remove(&longest);
        }
        // The count has this object itself.
        if Arc::strong_count(&self.at_work) > MOST {
            return Err(format!(
                "{MOST} sites are looked at, and the copy of one of them is being ended"
            ));
        }
        open.insert(site.to_owned(), self.begin(site)?);
        reading()
    }

    fn begin(&self, site: &str) -> Result<Shelf, String> {
        let folder = self.folder.as_ref().map_err(Clone::clone)?;
        let path = folder
            .path()
            .join(format!("{site}-{}.db", clock::now().as_nanos()));
        let (stop, stopped) = watch::channel(false);
        let copy = Arc::new(Shared {
            state: Mutex::new(State::Reading),
            asked: Mutex::new(Instant::now()),
        });
        let shown = Shown::new(&path);
        let name = site.to_owned();
        let refused = move |_, _| {
            Err(format!(
                "acknowledge it at the centre: `tirante hub command {name} acknowledge ALARM --by NAME --reason TEXT`"
            ))
        };
        let api = Api::new(Arc::clone(&shown), self.access.clone(), refused, stopped.clone());
        let work = Work {
            config: Arc::clone(&self.config),
            site: site.to_owned(),
            path,
            copy: Arc::clone(&copy),
            api: api.clone(),
            stopped: stopped.clone(),
            pace: self.pace,
            _at_work: Arc::clone(&self.at_work),
        };
        thread::Builder::new()
            .name(format!("copy {site}"))
            .spawn(move || work.run())
            .map_err(|error| format!("no thread for the copy of {site}: {error}"))?;
        tokio::spawn(shown.watch(stopped));
        Ok(Shelf {
            pages: TowerToHyperService::new(http::routes(None, Some(api))),
            copy,
            stop,
        })
    }
}

impl Drop for Shelf {
    fn drop(&mut self) {
        self.stop.send_replace(true);
    }
}

/// The file by which the page knows that it is a centre's; names of sites are letters, digits, '-' and '_'.
fn place(site: &str) -> Response {
    let script = format!("export const siteAtCentre = \"{site}\";\n");
    ([(header::CONTENT_TYPE, "text/javascript; charset=utf-8")], script).into_response()
}

fn later(why: &str) -> Response {
    let body = serde_json::json!({ "error": why }).to_string() + "\n";
    let headers = [
        (header::CONTENT_TYPE, "application/json"),
        (header::RETRY_AFTER, "1"),
    ];
    (StatusCode::SERVICE_UNAVAILABLE, headers, body).into_response()
}

/// The thread that keeps a copy.
struct Work {
    config: Arc<HubConfig>,
    site: String,
    path: PathBuf,
    copy: Arc<Shared>,
    api: Api,
    stopped: watch::Receiver<bool>,
    pace: (Duration, Duration),
    _at_work: Arc<()>,
}

impl Work {
    fn run(self) {
        let end = match self.follow() {
            Ok(()) => State::Ended,
            Err(error) => State::Failed(error.to_string()),
        };
        for suffix in ["", "-wal", "-shm", ".lock"] {
            let mut path = self.path.clone().into_os_string();
            path.push(suffix);
            let _ = fs::remove_file(path);
        }
        *self.copy.state() = end;
    }

    fn is_stopped(&self) -> bool {
        *self.stopped.borrow()
    }

    /// Follows the centre until it is stopped, or nobody has asked for long enough.
    fn follow(&self) -> Result<(), CopyError> {
        let (renew, unasked) = self.pace;
        let mut centre = super::beside(&self.config.storage)?;
        let oldest = clock::now().plus_seconds(-self.config.copies.shown_s);
        let from = month_of(Some(oldest.as_nanos()));
        let mut copy = SiteCopy::begin(&mut centre, &self.site, None, Some(from), &self.path)?;
        loop {
            copy.renew(&mut centre, &|| self.is_stopped())?;
            *self.copy.state() = State::Ready;
            if self.api.has_listeners() {
                *self.copy.asked() = Instant::now();
            }
            let is_watched = self.copy.asked().elapsed() < WATCHED;
            let until = Instant::now() + if is_watched { renew } else { renew * UNWATCHED };
            while Instant::now() < until && !self.is_stopped() {
                thread::sleep(Duration::from_millis(50));
            }
            if self.is_stopped() || self.copy.asked().elapsed() > unasked {
                return Ok(());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::hub::post::{Post, store};
    use axum::body::Body;

    const SITES: [&str; 9] = ["s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9"];

    /// A centre with a store of each site, and copies that are renewed at once and wait for questions as long as told.
    fn copies(unasked: Duration) -> (Post, Arc<Copies>) {
        let mut post = Post::new();
        post.again(&SITES);
        let folder = post.folder.path();
        let mut text = format!(
            "[nats]\nto = \"nats://127.0.0.1\"\n[sqlite]\npath = \"{}\"\n",
            folder.join("centre.db").display()
        );
        for site in SITES {
            text += &format!("[[site]]\nname = \"{site}\"\n");
        }
        let config = Arc::new(HubConfig::parse(&text, "hub.toml").unwrap());
        let access = Access::of(&config.http).unwrap();
        for site in SITES {
            comes(&mut post, site);
        }
        let mut copies = Copies::new(config, access);
        Arc::get_mut(&mut copies).unwrap().pace = (Duration::from_millis(10), unasked);
        (post, copies)
    }

    /// A new store of a site comes.
    fn comes(post: &mut Post, site: &str) {
        let message = post.of(site, &store(), 1, 6);
        post.send(&message);
    }

    /// Asks until there is an answer, and returns the reasons why there was none before.
    fn ask(copies: &Copies, site: &str) -> Vec<String> {
        let until = Instant::now() + Duration::from_secs(60);
        let mut why = Vec::new();
        loop {
            assert!(Arc::strong_count(&copies.at_work) <= 1 + MOST);
            match copies.pages(site) {
                Ok(_) => return why,
                Err(reason) => why.push(reason),
            }
            assert!(Instant::now() < until, "{why:?}");
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Names of the files of copies.
    fn files(copies: &Copies) -> Vec<String> {
        let folder = copies.folder.as_ref().unwrap().path();
        let names = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| name.ends_with(".db")).collect()
    }

    fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
        let until = Instant::now() + Duration::from_secs(60);
        while !is_so() {
            assert!(Instant::now() < until, "{what}");
            thread::sleep(Duration::from_millis(5));
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn the_ninth_takes_the_place_of_the_one_that_was_asked_for_longest_ago() {
        let (_post, copies) = copies(Duration::from_secs(3600));
        for site in &SITES[..8] {
            ask(&copies, site);
        }
        ask(&copies, "s1");
        assert_eq!(copies.open.lock().unwrap().len(), 8);
        ask(&copies, "s9");
        let open: Vec<String> = copies.open.lock().unwrap().keys().cloned().collect();
        assert_eq!(open, ["s1", "s3", "s4", "s5", "s6", "s7", "s8", "s9"]);
        eventually("the file of the second is gone", || files(&copies).len() == 8);
        assert!(files(&copies).iter().all(|name| !name.starts_with("s2-")));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_copy_of_a_store_that_was_replaced_is_begun_anew() {
        let (mut post, copies) = copies(Duration::from_secs(3600));
        ask(&copies, "s1");
        comes(&mut post, "s1");
        eventually("it is no longer followed", || {
            copies
                .pages("s1")
                .is_err_and(|why| why.contains("the store of site s1 was replaced"))
        });
        let why = ask(&copies, "s1");
        assert!(
            why.iter().all(|reason| reason.contains("are being read")),
            "{why:?}"
        );
        eventually("one file is left", || files(&copies).len() == 1);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_copy_that_nobody_asks_for_ends_by_itself() {
        let (_post, copies) = copies(Duration::from_millis(200));
        ask(&copies, "s1");
        eventually("its thread has ended", || Arc::strong_count(&copies.at_work) == 1);
        assert!(files(&copies).is_empty());
        // The next question begins anew.
        assert!(copies.pages("s1").unwrap_err().contains("are being read"));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn documents_and_scripts_need_no_copy() {
        let (_post, copies) = copies(Duration::from_secs(3600));
        for (path, status) in [
            ("/sites/s1/", 200),
            ("/sites/s1/rod?id=a%2Fb", 200),
            ("/sites/s1/assets/common.js", 200),
            ("/sites/s1/assets/place.js", 200),
            ("/sites/s1/favicon.ico", 404),
            ("/sites/none/", 404),
        ] {
            let request = Request::builder().uri(path).body(Body::empty()).unwrap();
            let site = path.split('/').nth(2).unwrap();
            let answer = Arc::clone(&copies).answer(site, request).await;
            assert_eq!(answer.status().as_u16(), status, "{path}");
        }
        assert!(copies.open.lock().unwrap().is_empty());
        let request = Request::builder()
            .uri("/sites/s1/api/v1/alarms")
            .body(Body::empty())
            .unwrap();
        let answer = Arc::clone(&copies).answer("s1", request).await;
        assert_eq!(answer.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(copies.open.lock().unwrap().len(), 1);
        let script = place("s1").into_body();
        let script = axum::body::to_bytes(script, 1000).await.unwrap();
        assert_eq!(&script[..], b"export const siteAtCentre = \"s1\";\n");
    }
}
