//! The page: three documents with their scripts and style, all embedded in the program.

use super::packed;
use axum::Router;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use flate2::Compression;
use std::sync::LazyLock;

/// Content security policy: the browser runs, shows and requests only what this server sends. `data:` images
/// are needed to save a picture.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
                      connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

/// A file of the page.
struct Asset {
    kind: &'static str,
    plain: &'static [u8],
    gzip: Vec<u8>,
    /// Tag that follows from the content.
    tag: String,
}

impl Asset {
    fn of(kind: &'static str, plain: &'static [u8]) -> Self {
        Self {
            kind,
            plain,
            gzip: packed::gzip(plain, Compression::default()),
            tag: packed::tag(plain),
        }
    }

    /// Answers with the file, or that the browser has it already.
    fn answer(&self, asked: &HeaderMap) -> Response {
        let mut response = if packed::has(asked, &self.tag) {
            StatusCode::NOT_MODIFIED.into_response()
        } else if packed::takes_gzip(asked) && !self.gzip.is_empty() {
            ([(header::CONTENT_ENCODING, "gzip")], self.gzip.clone()).into_response()
        } else {
            self.plain.into_response()
        };
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.kind));
        headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
        packed::mark(headers, &self.tag);
        response
    }
}

macro_rules! asset {
    ($kind:expr, $file:literal) => {
        LazyLock::new(|| Asset::of($kind, include_bytes!(concat!("page/", $file))))
    };
}

static SITE: LazyLock<Asset> = asset!(HTML, "site.html");
static ROD: LazyLock<Asset> = asset!(HTML, "rod.html");
static ALARMS: LazyLock<Asset> = asset!(HTML, "alarms.html");
static COMMON: LazyLock<Asset> = asset!(SCRIPT, "common.js");
static SITE_SCRIPT: LazyLock<Asset> = asset!(SCRIPT, "site.js");
static ROD_SCRIPT: LazyLock<Asset> = asset!(SCRIPT, "rod.js");
static PLACE: LazyLock<Asset> = asset!(SCRIPT, "place.js");
static ALARMS_SCRIPT: LazyLock<Asset> = asset!(SCRIPT, "alarms.js");
static LATEST: LazyLock<Asset> = asset!(SCRIPT, "latest.js");
static FIGURES: LazyLock<Asset> = asset!(SCRIPT, "figures.js");
static PLOT: LazyLock<Asset> = asset!(SCRIPT, "plot.js");
static SHEET: LazyLock<Asset> = asset!(STYLE, "style.css");
static ICON: LazyLock<Asset> = asset!("image/svg+xml", "icon.svg");

/// Routes of the page's documents and of the files they load.
pub fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let file =
        |asset: &'static LazyLock<Asset>| get(async move |request: Request| asset.answer(request.headers()));
    Router::new()
        .route("/", file(&SITE))
        .route("/rod", file(&ROD))
        .route("/alarms", file(&ALARMS))
        .route("/assets/common.js", file(&COMMON))
        .route("/assets/place.js", file(&PLACE))
        .route("/assets/site.js", file(&SITE_SCRIPT))
        .route("/assets/rod.js", file(&ROD_SCRIPT))
        .route("/assets/alarms.js", file(&ALARMS_SCRIPT))
        .route("/assets/latest.js", file(&LATEST))
        .route("/assets/figures.js", file(&FIGURES))
        .route("/assets/plot.js", file(&PLOT))
        .route("/assets/style.css", file(&SHEET))
        .route("/assets/icon.svg", file(&ICON))
}
