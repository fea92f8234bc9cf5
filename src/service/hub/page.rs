//! Page, API, health and metrics of the centre.

use super::copies::Copies;
use super::map;
use super::sites::{self, SiteRow};
use super::text;
use crate::config::HubConfig;
use crate::service::http::Access;
use crate::service::telemetry::{Beat, Health};
use crate::site::clock;
use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{Html, IntoResponse, Redirect, Response};
use axum::routing::{any, get};
use serde::Serialize;
use std::fmt::Write;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::Mutex;

/// Least and most time for which a list is shown again without asking the database.
const FRESH: Duration = Duration::from_millis(200);
const OLDEST: Duration = Duration::from_secs(2);

/// Time within which the database must answer.
const ANSWER: Duration = Duration::from_secs(10);
/// Time within which the folding must show a sign of life.
const ALIVE: Duration = Duration::from_secs(60);

/// Sites as they were at a time, and how long it took to read them.
struct Listed {
    at: Instant,
    took: Duration,
    rows: Arc<Vec<SiteRow>>,
}

/// Page of the centre.
#[derive(Clone)]
pub struct Page {
    config: Arc<HubConfig>,
    health: Arc<Health>,
    beat: Arc<Beat>,
    listed: Arc<Mutex<Option<Listed>>>,
    copies: Arc<Copies>,
}

impl Page {
    /// A page that reads the database of the configuration.
    pub fn new(config: Arc<HubConfig>, health: Arc<Health>, beat: Arc<Beat>, access: &Access) -> Self {
        Self {
            copies: Copies::new(Arc::clone(&config), access.clone()),
            config,
            health,
            beat,
            listed: Arc::default(),
        }
    }

    /// Routes of the page; a name that is not ours is not answered.
    pub fn routes(self, access: Access) -> Router {
        let hosts = middleware::from_fn(move |request: Request, next: Next| {
            let is_ours = access.is_host(request.headers());
            async move {
                if !is_ours {
                    let why = "this server does not answer to that name: put it into http.names\n";
                    return (StatusCode::MISDIRECTED_REQUEST, why).into_response();
                }
                let mut response = next.run(request).await;
                let strict = "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; connect-src 'self'; \
                              frame-ancestors 'none'; base-uri 'none'";
                for (name, value) in [
                    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
                    (header::CACHE_CONTROL, "no-store"),
                    (header::CONTENT_SECURITY_POLICY, strict),
                    (header::REFERRER_POLICY, "no-referrer"),
                ] {
                    // A site's page has stricter ones.
                    response
                        .headers_mut()
                        .entry(name)
                        .or_insert(HeaderValue::from_static(value));
                }
                response
            }
        });
        Router::new()
            .route("/", get(page))
            .route("/follow.js", get(script))
            .route("/api/v1/sites", get(api))
            .route("/api/v1/openapi.json", get(description))
            .route("/healthz", get(healthz))
            .route("/metrics", get(metrics))
            .route("/sites/{site}", get(with_slash))
            .route("/sites/{site}/", any(begin_of_site))
            .route("/sites/{site}/{*rest}", any(of_site))
            .layer(hosts)
            .with_state(self)
    }

    /// The list: as old as [`FRESH`], or as four times what it takes to make one, so that readers cost a fifth of the time at most.
    async fn asked(self) -> Result<Arc<Vec<SiteRow>>, Response> {
        let unavailable = |error: String| (StatusCode::SERVICE_UNAVAILABLE, error + "\n").into_response();
        let late = |_| unavailable("the database does not answer".to_owned());
        // One question at a time: while the database hangs, it holds one thread, and not one a request.
        let listed = tokio::time::timeout(ANSWER, self.listed.lock_owned());
        let mut listed = listed.await.map_err(late)?;
        if let Some(Listed { at, took, rows }) = &*listed
            && at.elapsed() < (4 * *took).clamp(FRESH, OLDEST)
        {
            return Ok(Arc::clone(rows));
        }
        let config = self.config;
        let list = tokio::task::spawn_blocking(move || {
            let list = || {
                let mut centre = super::beside(&config.storage)?;
                sites::list(&mut centre, &config.sites, clock::now().as_nanos())
            };
            let asked = Instant::now();
            let rows = Arc::new(list().map_err(|error: super::CentreError| error.to_string())?);
            *listed = Some(Listed {
                at: asked,
                took: asked.elapsed(),
                rows: Arc::clone(&rows),
            });
            Ok(rows)
        });
        match tokio::time::timeout(ANSWER, list).await.map_err(late)? {
            Ok(rows) => rows.map_err(unavailable),
            Err(error) => Err(unavailable(error.to_string())),
        }
    }
}

fn json<T: Serialize>(status: StatusCode, body: &T) -> Response {
    match serde_json::to_string(body) {
        Ok(text) => (status, [(header::CONTENT_TYPE, "application/json")], text + "\n").into_response(),
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{error}\n")).into_response(),
    }
}

async fn api(State(page): State<Page>) -> Response {
    match page.asked().await {
        Ok(rows) => json(StatusCode::OK, rows.as_ref()),
        Err(response) => response,
    }
}

async fn description() -> impl IntoResponse {
    let kind = [(header::CONTENT_TYPE, "application/json")];
    (kind, include_str!("../../../docs/openapi-hub.json"))
}

/// Answers 503 while nothing is folded.
async fn healthz(State(page): State<Page>) -> Response {
    let conditions: Vec<_> = page
        .health
        .conditions()
        .iter()
        .map(|one| serde_json::json!({ "about": one.about, "detail": one.detail }))
        .collect();
    let is_alive = page.beat.age() < ALIVE;
    let is_folding = is_alive && !conditions.iter().any(|one| one["about"] == super::ABOUT);
    let is_well = is_alive && conditions.is_empty();
    let body = serde_json::json!({
        "status": if is_well { "ok" } else { "degraded" },
        "folding": is_folding,
        "conditions": conditions,
        "version": env!("CARGO_PKG_VERSION"),
    });
    let status = if is_folding {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    json(status, &body)
}

async fn metrics(State(page): State<Page>) -> Response {
    let rows = match page.asked().await {
        Ok(rows) => rows,
        Err(response) => return response,
    };
    let mut out = String::new();
    let mut family = |name: &str, help: &str, value: &dyn Fn(&SiteRow) -> Option<f64>| {
        let _ = writeln!(out, "# TYPE {name} gauge\n# HELP {name} {help}");
        for row in rows.iter() {
            if let Some(value) = value(row) {
                let _ = writeln!(out, "{name}{{site=\"{}\"}} {value}", text::label(&row.site));
            }
        }
    };
    family("tirante_site_alarms", "Alarms that stand.", &|row| {
        Some(row.alarms as f64)
    });
    family(
        "tirante_site_parked_messages",
        "Messages that are not folded.",
        &|row| Some(row.parked as f64),
    );
    family(
        "tirante_site_heard_age_seconds",
        "Time since the latest message or heartbeat.",
        &|row| row.silent_s,
    );
    family(
        "tirante_site_silent",
        "1 if nothing is heard for longer than the site's limit.",
        &|row| Some(f64::from(u8::from(row.silent_since.is_some()))),
    );
    family(
        "tirante_site_clock_off_seconds",
        "Lead of the site's clock over the post's; 0 within a minute.",
        &|row| row.beat.as_ref().map(|_| row.clock_off_s.unwrap_or(0.0)),
    );
    family(
        "tirante_site_stopped",
        "1 if nothing is measured or stored at the site.",
        &|row| {
            row.beat
                .as_ref()
                .map(|_| f64::from(u8::from(row.stopped_since.is_some())))
        },
    );
    family(
        "tirante_site_behind_commits",
        "Commits of the site that have not come yet, by its latest heartbeat.",
        &|row| row.behind.map(|behind| behind as f64),
    );
    family(
        "tirante_site_commits",
        "Last commit folded of the present store.",
        &|row| Some(row.through as f64),
    );
    family("tirante_site_stores", "Stores of the site so far.", &|row| {
        Some(row.stores as f64)
    });
    out += "# EOF\n";
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], out).into_response()
}

/// The address with the slash from which the links of a site's page begin.
async fn with_slash(State(page): State<Page>, Path(site): Path<String>) -> Response {
    match page.config.site(&site) {
        Some(listed) => Redirect::permanent(&format!("{}/", listed.name)).into_response(),
        None => (StatusCode::NOT_FOUND, "there is no such site on the list\n").into_response(),
    }
}

async fn begin_of_site(State(page): State<Page>, Path(site): Path<String>, request: Request) -> Response {
    page.copies.answer(&site, request).await
}

async fn of_site(
    State(page): State<Page>,
    Path((site, _)): Path<(String, String)>,
    request: Request,
) -> Response {
    page.copies.answer(&site, request).await
}

async fn page(State(page): State<Page>) -> Response {
    let config = Arc::clone(&page.config);
    match page.asked().await {
        Ok(rows) => Html(html(&rows, &config)).into_response(),
        Err(response) => response,
    }
}

/// Replaces the list when it has changed: four times a second at most, and seldom enough that asking takes a fifth of the time; every half
/// minute while nobody looks. A page that reloads itself would take the reader's place away.
const SCRIPT: &str = r#"const live = document.getElementById("live");
let shown = "";
let next;
function show(text) {
  const fresh = new DOMParser().parseFromString(text, "text/html").getElementById("sites");
  const focused = document.activeElement?.getAttribute("href");
  document.getElementById("sites").replaceWith(fresh);
  if (focused) fresh.querySelector(`[href="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
}
async function follow() {
  clearTimeout(next);
  const asked = performance.now();
  let least = document.hidden ? 30000 : 250;
  try {
    const answer = await fetch("./", { signal: AbortSignal.timeout(20000) });
    const text = await answer.text();
    if (!answer.ok) throw new Error(text);
    if (!getSelection().isCollapsed) {
      live.textContent = "The list waits while text is selected.";
    } else {
      if (text !== shown) show(text);
      shown = text;
      live.textContent = "";
    }
  } catch (error) {
    if (!live.textContent.startsWith("No answer"))
      live.textContent = `No answer since ${new Date().toISOString().slice(0, 16).replace("T", " ")} UTC: what is shown is old. ${error.message}`;
    least = Math.max(least, 2000);
  }
  clearTimeout(next);
  next = setTimeout(follow, Math.max(least, 4 * (performance.now() - asked)));
}
document.addEventListener("visibilitychange", () => document.hidden || follow());
follow();
"#;

async fn script() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "text/javascript; charset=utf-8")], SCRIPT)
}

const HEAD: &str = "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><meta name=\"description\" content=\"All sites, worst first\"><title>Tirante: sites</title>\
<link rel=\"icon\" href=\"data:,\"><script src=\"follow.js\" type=\"module\"></script>\
<style>:root{color-scheme:light dark;--ink:#1b2026;--paper:#fff;--soft:#5b6672;--link:#1f6cb0;--alarm:#b3261e;--warn:#7a5d00;--good:#25724a}\
@media(prefers-color-scheme:dark){:root{--ink:#e6eaee;--paper:#14181c;--soft:#9ba7b3;--link:#6db3f2;--alarm:#ff8a80;--warn:#e2c25c;--good:#6fce9b}}\
body{font:16px/1.45 system-ui,sans-serif;margin:1.5rem auto;max-width:75rem;padding:0 1rem;color:var(--ink);background:var(--paper)}a{color:var(--link)}\
h1{font-size:1.4rem}table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.4rem .6rem .4rem 0;border-bottom:1px solid #8886;vertical-align:top}\
tbody th{font-weight:600}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}.w{font-weight:600;white-space:nowrap}.alarm,#live{color:var(--alarm)}\
#map{width:100%;height:auto;border:1px solid #8886;margin:.5rem 0}#map text{font-size:13px;fill:var(--ink)}#map circle{fill:var(--soft);stroke:var(--paper);stroke-width:1.5}\
#map circle.alarm{fill:var(--alarm)}#map circle.parked,#map circle.silent,#map circle.not-monitoring{fill:var(--warn)}#map circle.monitoring{fill:var(--good)}\
#map a:focus circle,#map a:hover circle{stroke:var(--ink)}#map path.grid{stroke:#8884;fill:none}#map text.grid{font-size:11px;fill:var(--soft)}#map path.scale{stroke:var(--ink);stroke-width:2}\
.parked,.silent,.not-monitoring{color:var(--warn)}.monitoring{color:var(--good)}small{display:block;color:var(--soft)}\
@media(max-width:46rem){thead{position:absolute;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)}tbody,tr,td,tbody th{display:block}\
tr{border-bottom:2px solid #8886;padding:.5rem 0}td,tbody th,td.n{border:0;padding:.1rem 0;text-align:left}td::before{content:attr(data-name) \": \";color:var(--soft)}}\
</style></head><body><main><h1>Sites</h1><p id=\"live\" role=\"status\"></p><div id=\"sites\">";

fn html(rows: &[SiteRow], config: &HubConfig) -> String {
    let mut out = HEAD.to_owned();
    let alarms = rows.iter().filter(|row| row.alarms > 0).count();
    let _ = write!(
        out,
        "<p>{} sites, {alarms} with an alarm. Worst first. <a href=\"api/v1/sites\">JSON</a> · <a href=\"metrics\">metrics</a></p>",
        rows.len()
    );
    out += &map::svg(rows, &config.sites).unwrap_or_default();
    out += "<table><thead><tr><th>Site<th>Worst<th>Rods<th class=n>Alarms<th>Latest record (UTC)<th>Heard (UTC)<th>History</tr></thead><tbody>";
    for row in rows {
        let name = escaped(&row.site);
        // A site that only sends has no page: nothing of it is taken.
        let mut name = if config.site(&row.site).is_some() {
            format!("<a href=\"sites/{name}/\">{name}</a>")
        } else {
            name
        };
        if let Some(link) = &row.link {
            let _ = write!(name, "<small><a href=\"{}\">own page</a></small>", escaped(link));
        }
        let rods: Vec<String> = row
            .rods
            .iter()
            .map(|(state, count)| format!("{count} {}", escaped(state)))
            .collect();
        let dash = |time: &Option<String>| time.as_deref().map_or_else(|| "–".to_owned(), to_the_minute);
        let detail = row
            .detail
            .as_ref()
            .map(|detail| format!("<small>{}</small>", escaped(detail)));
        let said: String = row
            .sentences()
            .iter()
            .map(|said| format!("<small>{}</small>", escaped(said)))
            .collect();
        let history = match row.stores {
            0 => "–".to_owned(),
            1 => "one store".to_owned(),
            count => format!("{count} stores, the present one since {}", dash(&row.since)),
        };
        let _ = write!(
            out,
            "<tr><th scope=row>{name}<td data-name=worst><span class=\"w {code}\">{code}</span>{}<td data-name=rods>{}\
             <td class=n data-name=alarms>{}<td data-name=\"latest record\">{}<td data-name=heard>{}{said}<td data-name=history>{history}</tr>",
            detail.unwrap_or_default(),
            rods.join(", "),
            row.alarms,
            dash(&row.latest_record),
            dash(&row.heard),
            code = row.worst.code(),
        );
    }
    out + "</tbody></table></div></main></body></html>\n"
}

/// A time of the list, `2026-03-01T06:00:00Z`, as `2026-03-01 06:00`.
fn to_the_minute(time: &str) -> String {
    match (time.get(..10), time.get(11..16)) {
        (Some(day), Some(clock)) => format!("{day} {clock}"),
        _ => escaped(time),
    }
}

/// Text as part of a document.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
