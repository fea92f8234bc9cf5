//! Routes of the HTTP server.

use super::api::{self, Api};
use super::{page, problem, viewer};
use crate::service::telemetry::{Report, Telemetry};
use axum::Router;
use axum::body::HttpBody;
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Largest age of the latest beat of a work loop that is alive.
const ALIVE: Duration = Duration::from_secs(30);

/// Longest path with its query \[bytes\].
const LONGEST_PATH: usize = 4096;

const JSON: &str = "application/json";
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Headers that let a browser run, keep, frame or guess nothing.
const STRICT: [(HeaderName, HeaderValue); 4] = [
    (
        header::X_CONTENT_TYPE_OPTIONS,
        HeaderValue::from_static("nosniff"),
    ),
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    (
        header::CONTENT_SECURITY_POLICY,
        HeaderValue::from_static("default-src 'none'; frame-ancestors 'none'"),
    ),
    (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
];

#[derive(Clone)]
struct Shared {
    telemetry: Telemetry,
    begun: Instant,
}

/// Routes: health, readiness and metrics of a daemon, the page and API of a store.
pub fn routes(telemetry: Option<Telemetry>, api: Option<Api>) -> Router {
    let mut router = Router::new();
    if let Some(telemetry) = telemetry {
        let shared = Shared {
            telemetry,
            begun: Instant::now(),
        };
        let health = Router::new()
            .route("/healthz", get(health))
            .route("/readyz", get(ready))
            .route("/metrics", get(metrics))
            .with_state(shared);
        router = router.merge(health);
    }
    if let Some(api) = api {
        let access = api.access.clone();
        let hosts = middleware::from_fn(move |request: Request, next: Next| {
            let is_ours = access.is_host(request.headers());
            async move {
                if is_ours {
                    next.run(request).await
                } else {
                    foreign()
                }
            }
        });
        let site = page::routes()
            .merge(api::routes())
            .route("/viewer", get(viewer::open))
            .layer(hosts)
            .with_state(api);
        router = router.merge(site);
    }
    closed(router)
}

/// Routes of the page's documents and files alone, which are the same for every store.
pub fn documents() -> Router {
    closed(page::routes())
}

/// Answers what no route has, and puts the guard before all of them.
fn closed(router: Router) -> Router {
    let nothing = "there is nothing here; try /, /api/v1/openapi.json, /healthz, /readyz, /metrics\n";
    router
        .fallback(move |request: Request| async move {
            let answer = (StatusCode::NOT_FOUND, nothing).into_response();
            if request.uri().path().starts_with("/api/") {
                problem::as_json(answer).await
            } else {
                answer
            }
        })
        .layer(middleware::from_fn(guard))
}

/// The answer to a host name that is not ours.
fn foreign() -> Response {
    let why = "this server does not answer to that name: put it into http.names of the configuration\n";
    (StatusCode::MISDIRECTED_REQUEST, why).into_response()
}

/// Body of `/healthz`, as JSON.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: Report,
    version: &'static str,
    uptime_s: u64,
    beat_age_s: f64,
}

/// Answers 200 while the work loop is alive, or while the daemon starts, which systemd limits.
async fn health(State(shared): State<Shared>) -> Response {
    let telemetry = &shared.telemetry;
    let age = telemetry.beat.age();
    let body = Body {
        report: telemetry.health.report(),
        version: env!("CARGO_PKG_VERSION"),
        uptime_s: shared.begun.elapsed().as_secs(),
        beat_age_s: age.as_secs_f64(),
    };
    let is_alive = age < ALIVE || body.report.phase.is_starting();
    let status = if is_alive {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    match serde_json::to_string(&body) {
        Ok(mut text) => {
            text.push('\n');
            (status, [(header::CONTENT_TYPE, JSON)], text).into_response()
        }
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
    }
}

/// Answers 200 while data may come, else the reason why not.
async fn ready(State(shared): State<Shared>) -> (StatusCode, String) {
    let telemetry = &shared.telemetry;
    let age = telemetry.beat.age();
    let not_ready = match telemetry.health.phase().not_ready() {
        Some(reason) => Some(reason.to_owned()),
        None if age >= ALIVE => Some(format!("the work loop stands still for {} s", age.as_secs())),
        None => None,
    };
    match not_ready {
        Some(reason) => (StatusCode::SERVICE_UNAVAILABLE, format!("{reason}\n")),
        None => (StatusCode::OK, "ready\n".to_owned()),
    }
}

async fn metrics(State(shared): State<Shared>) -> impl IntoResponse {
    (
        [(header::CONTENT_TYPE, OPEN_METRICS)],
        shared.telemetry.metrics.text(),
    )
}

/// Refuses bodies and long paths, which no route needs, and sets the strict headers on every answer.
async fn guard(request: Request, next: Next) -> Response {
    let path = request
        .uri()
        .path_and_query()
        .map_or(0, |path| path.as_str().len());
    let mut response = if path > LONGEST_PATH {
        StatusCode::URI_TOO_LONG.into_response()
    } else if !request.body().is_end_stream() {
        let close = [(header::CONNECTION, "close")];
        (
            StatusCode::PAYLOAD_TOO_LARGE,
            close,
            "no request here has a body\n",
        )
            .into_response()
    } else {
        next.run(request).await
    };
    for (name, value) in STRICT {
        // The page sets a more exact policy.
        response.headers_mut().entry(name).or_insert(value);
    }
    response
}
