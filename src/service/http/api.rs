//! `/api/v1`: bounded queries of the store; docs/openapi.json describes each.

use super::access::Access;
use super::live;
use super::packed;
use super::problem::{self, Problem};
use super::shown::{Shown, Unanswered};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::service::api::{
    Alarms, Chart, Days, Frequencies, History, Looks, Monitoring, Records, RodAnswer, SiteAnswer, listing,
};
use crate::service::telemetry::{Fault, Health};
use crate::service::viewer::Signals;
use crate::site::clock;
use crate::site::store::{Asked, Reader, StoreError};
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Router, middleware};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use tokio::sync::{Semaphore, watch};

/// Most rows of a page of records or alarms, and the default.
const ROWS: (usize, usize) = (500, 50);

/// Most points of a history, and the default.
const POINTS: (usize, usize) = (5000, 1500);

/// Most periods of a chart, and the default.
const PERIODS: (usize, usize) = (4000, 1500);

/// Shared state of all answers.
#[derive(Clone)]
pub struct Api {
    /// Store behind the page.
    pub(super) shown: Arc<Shown>,
    /// Rules of access.
    pub(super) access: Access,
    /// Puts a request into the store.
    ask_writer: Arc<dyn Fn(RodId, Asked) -> Result<String, String> + Send + Sync>,
    /// Conditions of the daemon that answers, if one does.
    health: Option<Arc<Health>>,
    /// Live signals of the daemon that answers; empty without one.
    pub(super) signals: Arc<Signals>,
    /// Channel that becomes true when the server ends.
    pub(super) stop: watch::Receiver<bool>,
    /// Places of clients that listen to events.
    pub(super) listeners: Arc<Semaphore>,
}

impl Api {
    /// State for a store.
    pub fn new(
        shown: Arc<Shown>,
        access: Access,
        ask_writer: impl Fn(RodId, Asked) -> Result<String, String> + Send + Sync + 'static,
        stop: watch::Receiver<bool>,
    ) -> Self {
        Self {
            shown,
            access,
            ask_writer: Arc::new(ask_writer),
            health: None,
            signals: Arc::default(),
            stop,
            listeners: Arc::new(Semaphore::new(live::LISTENERS)),
        }
    }

    /// Adds the conditions and the live signals of a running daemon.
    pub fn of_daemon(mut self, health: Arc<Health>, signals: Arc<Signals>) -> Self {
        self.health = Some(health);
        self.signals = signals;
        self
    }

    /// True while a page listens to events.
    pub fn has_listeners(&self) -> bool {
        self.listeners.available_permits() < live::LISTENERS
    }

    /// Answers a query that needs the daily sums.
    async fn answer<T: Serialize + Send + 'static>(
        &self,
        question: impl FnOnce(&Reader, &Days) -> Result<Result<T, Problem>, StoreError> + Send + 'static,
    ) -> Result<Response, Problem> {
        let (shown, health) = (Arc::clone(&self.shown), self.health.clone());
        say(move || {
            shown
                .ask(question)
                .map_err(|why| reason(health.as_deref(), why))?
        })
        .await
    }

    /// Answers a query that is possible from the start.
    async fn answer_at_once<T: Serialize + Send + 'static>(
        &self,
        question: impl FnOnce(&Reader) -> Result<Result<T, Problem>, StoreError> + Send + 'static,
    ) -> Result<Response, Problem> {
        let (shown, health) = (Arc::clone(&self.shown), self.health.clone());
        say(move || {
            let answer = shown.read(question);
            answer.map_err(|error| reason(health.as_deref(), error.into()))?
        })
        .await
    }
}

/// Reason why there is no answer: a daemon knows if its store was moved away, or another put in its place.
fn reason(health: Option<&Health>, why: Unanswered) -> Problem {
    let conditions = health.map(Health::conditions).unwrap_or_default();
    let lost = conditions
        .into_iter()
        .find(|lasting| lasting.fault == Fault::Files);
    match (why, lost) {
        (Unanswered::Store(_), Some(lost)) => problem::unavailable(lost.detail),
        (why, _) => why.into(),
    }
}

/// Runs a query on a blocking thread and returns its answer as JSON.
async fn say<T: Serialize>(
    question: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<Response, Problem> {
    let work = move || -> Result<String, Problem> {
        let answer = question()?;
        serde_json::to_string(&answer).map_err(|error| problem::unavailable(error.to_string()))
    };
    let text = tokio::task::spawn_blocking(work)
        .await
        .map_err(|_| problem::unavailable("the program broke while it answered, please report it"))??;
    Ok(([(header::CONTENT_TYPE, "application/json")], text).into_response())
}

/// Routes below `/api/v1`.
pub fn routes() -> Router<Api> {
    Router::new()
        .route("/api/v1/openapi.json", get(description))
        .route("/api/v1/site", get(site))
        .route("/api/v1/rods/{rod}", get(rod))
        .route("/api/v1/rods/{rod}/history", get(history))
        .route("/api/v1/rods/{rod}/frequencies", get(frequencies))
        .route("/api/v1/rods/{rod}/records", get(records))
        .route("/api/v1/rods/{rod}/chart", get(chart))
        .route("/api/v1/rods/{rod}/latest", get(latest))
        .route("/api/v1/alarms", get(alarms))
        .route("/api/v1/alarms/{id}/acknowledge", post(acknowledge))
        .layer(middleware::map_response(problem::as_json))
        .layer(middleware::from_fn(packed::pack))
        .route("/api/v1/events", get(events))
}

async fn description() -> impl IntoResponse {
    let kind = [(header::CONTENT_TYPE, "application/json")];
    (kind, include_str!("../../../docs/openapi.json"))
}

async fn site(State(api): State<Api>) -> Result<Response, Problem> {
    let health = api.health.clone();
    api.answer(move |reader, days| {
        let mut answer = SiteAnswer::of(reader, days)?;
        // What lasts now is in the store only once it has lasted for a while, and if the store can be written.
        if let Some(health) = health {
            answer.monitoring = Some(Monitoring::live(&health.conditions(), clock::now()));
        }
        Ok(Ok(answer))
    })
    .await
}

async fn rod(State(api): State<Api>, Path(rod): Path<String>) -> Result<Response, Problem> {
    api.answer(move |reader, days| {
        let found = RodAnswer::of(reader, days, &RodId(rod.clone()))?;
        Ok(found.ok_or_else(|| no_rod(&rod)))
    })
    .await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Span {
    from: Option<String>,
    to: Option<String>,
    points: Option<usize>,
}

/// Answers about a rod's records of a stretch of time, by default all.
async fn stretch<T: Serialize + Send + 'static>(
    api: &Api,
    rod: String,
    span: Span,
    of: impl FnOnce(&Reader, &Days, &RodId, (Timestamp, Timestamp), usize) -> Result<T, StoreError>
    + Send
    + 'static,
) -> Result<Response, Problem> {
    let (from, to) = (
        time("from", span.from.as_deref())?,
        time("to", span.to.as_deref())?,
    );
    if let (Some(from), Some(to)) = (from, to)
        && from >= to
    {
        return Err(problem::bad("from: must be before to"));
    }
    let points = within("points", span.points, POINTS)?;
    api.answer(move |reader, days| {
        let rod = RodId(rod);
        let (first, end) = match days.span(&rod) {
            Some(span) => span,
            // A rod of which nothing has come has a history: an empty one.
            None if reader.standing(&rod)?.is_some() => (Timestamp::from_nanos(0), Timestamp::from_nanos(0)),
            None => return Ok(Err(no_rod(&rod.0))),
        };
        let span = (from.unwrap_or(first), to.unwrap_or(end));
        Ok(Ok(of(reader, days, &rod, span, points)?))
    })
    .await
}

async fn history(
    State(api): State<Api>,
    Path(rod): Path<String>,
    Query(span): Query<Span>,
) -> Result<Response, Problem> {
    stretch(&api, rod, span, History::of).await
}

async fn frequencies(
    State(api): State<Api>,
    Path(rod): Path<String>,
    Query(span): Query<Span>,
) -> Result<Response, Problem> {
    stretch(&api, rod, span, Frequencies::of).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Page {
    before: Option<String>,
    limit: Option<usize>,
    rejected: Option<bool>,
}

async fn records(
    State(api): State<Api>,
    Path(rod): Path<String>,
    Query(page): Query<Page>,
) -> Result<Response, Problem> {
    let before = match page.before.as_deref() {
        Some(next) => {
            Some(listing::mark(next).ok_or_else(|| problem::bad("before: take `next` of another page"))?)
        }
        None => None,
    };
    let most = within("limit", page.limit, ROWS)?;
    let only_rejected = page.rejected.unwrap_or(false);
    api.answer(move |reader, days| {
        let rod = RodId(rod);
        if days.span(&rod).is_none() && reader.standing(&rod)?.is_none() {
            return Ok(Err(no_rod(&rod.0)));
        }
        Ok(Ok(Records::of(reader, days, &rod, before, only_rejected, most)?))
    })
    .await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Periods {
    periods: Option<usize>,
}

async fn chart(
    State(api): State<Api>,
    Path(rod): Path<String>,
    Query(asked): Query<Periods>,
) -> Result<Response, Problem> {
    let most = within("periods", asked.periods, PERIODS)?;
    api.answer_at_once(move |reader| {
        let rod = RodId(rod);
        Ok(match reader.standing(&rod)? {
            Some(_) => Ok(Chart::of(reader, &rod, most)?),
            None => Err(no_rod(&rod.0)),
        })
    })
    .await
}

async fn latest(State(api): State<Api>, Path(rod): Path<String>) -> Result<Response, Problem> {
    api.answer_at_once(move |reader| {
        let rod = RodId(rod);
        Ok(match reader.standing(&rod)? {
            Some(_) => Ok(Looks::of(reader, &rod)?),
            None => Err(no_rod(&rod.0)),
        })
    })
    .await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AlarmPage {
    rod: Option<String>,
    standing: Option<bool>,
    before: Option<String>,
    limit: Option<usize>,
}

async fn alarms(State(api): State<Api>, Query(page): Query<AlarmPage>) -> Result<Response, Problem> {
    let most = within("limit", page.limit, ROWS)?;
    api.answer_at_once(move |reader| {
        let rod = page.rod.map(RodId);
        let standing = page.standing.unwrap_or(false);
        let found = Alarms::of(reader, rod.as_ref(), standing, page.before.as_deref(), most)?;
        // A rod that was taken out of the configuration has its alarms still.
        if let (Some(rod), Some(found)) = (&rod, &found)
            && found.alarms.is_empty()
            && reader.standing(rod)?.is_none()
        {
            return Ok(Err(no_rod(&rod.0)));
        }
        Ok(found.ok_or_else(|| problem::bad("before: take `next` of another page")))
    })
    .await
}

/// Result of a request.
#[derive(Serialize)]
struct Acknowledged {
    alarm: String,
    /// Time of its effect, in words.
    when: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Words {
    by: Option<String>,
    note: Option<String>,
}

async fn acknowledge(
    State(api): State<Api>,
    Path(id): Path<String>,
    Query(words): Query<Words>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if !api.access.has_token() {
        return Err(problem::unauthorized(
            "nothing can be changed here: the configuration names no http.token_file",
        ));
    }
    if !api.access.may_write(&headers) {
        return Err(problem::unauthorized("this needs the token of http.token_file"));
    }
    let (shown, ask_writer) = (Arc::clone(&api.shown), Arc::clone(&api.ask_writer));
    say(move || {
        let alarm = shown.read(|reader| reader.alarm(&id))?;
        let Some(alarm) = alarm else {
            return Err(problem::missing(format!("there is no alarm {id}")));
        };
        // Outside the question: it may look at the whole store first, and others ask meanwhile.
        let when = match alarm.acknowledged {
            Some(time) => format!("it was acknowledged at {time}"),
            None => {
                let asked = Asked::acknowledge(&id, words.by.as_deref(), words.note.as_deref());
                ask_writer(alarm.rod, asked).map_err(problem::unavailable)?
            }
        };
        Ok(Acknowledged { alarm: id, when })
    })
    .await
}

async fn events(State(api): State<Api>) -> Response {
    live::events(&api.shown, &api.listeners, api.stop.clone())
}

fn no_rod(rod: &str) -> Problem {
    problem::missing(format!("the store has no rod {rod}"))
}

/// Parses a day or a time.
fn time(name: &str, text: Option<&str>) -> Result<Option<Timestamp>, Problem> {
    text.map(Timestamp::as_written)
        .transpose()
        .map_err(|why| problem::bad(format!("{name}: {why}")))
}

/// Checks a number between 1 and its maximum.
fn within(name: &str, asked: Option<usize>, (most, usual): (usize, usize)) -> Result<usize, Problem> {
    match asked {
        None => Ok(usual),
        Some(number) if (1..=most).contains(&number) => Ok(number),
        Some(number) => Err(problem::bad(format!("{name}={number}: from 1 to {most}"))),
    }
}
