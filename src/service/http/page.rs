//! The page: three documents, their script and style, and the plot library, all from within the program.

use crate::site::hex::hex;
use axum::Router;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest, Sha256};
use std::io::Write;
use std::sync::LazyLock;

/// Content security policy of the page: run, show and ask only what this server sends. Plotly writes `style`
/// attributes, which the style rule has to let pass.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; \
                      connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

/// A file of the page.
struct Asset {
    kind: &'static str,
    plain: Vec<u8>,
    gzip: Vec<u8>,
    /// Tag that follows from the content.
    tag: String,
}

impl Asset {
    fn of(kind: &'static str, plain: &[u8]) -> Self {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        // Writing to memory cannot fail; without a compressed form the plain one is sent.
        let gzip = encoder
            .write_all(plain)
            .and_then(|()| encoder.finish())
            .unwrap_or_default();
        let hash = Sha256::digest(plain);
        let tag = hex(&hash[..8]);
        Self {
            kind,
            plain: plain.to_vec(),
            gzip,
            tag: format!("\"{tag}\""),
        }
    }

    /// Answers with the file, or that the browser has it already.
    fn answer(&self, asked: &HeaderMap) -> Response {
        let said = |name| {
            asked
                .get(name)
                .and_then(|value: &HeaderValue| value.to_str().ok())
        };
        let is_known =
            said(header::IF_NONE_MATCH).is_some_and(|tags| tags.split(", ").any(|tag| tag == self.tag));
        let takes_gzip = said(header::ACCEPT_ENCODING).is_some_and(|list| list.contains("gzip"));
        let mut response = if is_known {
            StatusCode::NOT_MODIFIED.into_response()
        } else if takes_gzip && !self.gzip.is_empty() {
            ([(header::CONTENT_ENCODING, "gzip")], self.gzip.clone()).into_response()
        } else {
            self.plain.clone().into_response()
        };
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.kind));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
        headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
        headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
        if let Ok(tag) = HeaderValue::from_str(&self.tag) {
            headers.insert(header::ETAG, tag);
        }
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
static ALARMS_SCRIPT: LazyLock<Asset> = asset!(SCRIPT, "alarms.js");
static FIGURES: LazyLock<Asset> = asset!(SCRIPT, "figures.js");
static SHEET: LazyLock<Asset> = asset!(STYLE, "style.css");
static ICON: LazyLock<Asset> = asset!("image/svg+xml", "icon.svg");
static PLOTLY: LazyLock<Asset> = LazyLock::new(|| Asset::of(SCRIPT, plotly().as_bytes()));

/// The plot library: the first of the scripts that its package embeds. The other one typesets formulas, which no plot here
/// has.
fn plotly() -> String {
    let scripts = plotly::Plot::offline_js_sources();
    let script = scripts
        .split_once('>')
        .and_then(|(_, rest)| rest.split_once("</script>"));
    script.map(|(script, _)| script.to_owned()).unwrap_or_default()
}

/// Routes of the page's documents and of the files they load.
pub fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let file =
        |asset: &'static LazyLock<Asset>| get(async move |request: Request| asset.answer(request.headers()));
    // Compressed while the server starts, not while somebody waits.
    std::thread::spawn(|| LazyLock::force(&PLOTLY).plain.len());
    Router::new()
        .route("/", file(&SITE))
        .route("/rod", file(&ROD))
        .route("/alarms", file(&ALARMS))
        .route("/assets/common.js", file(&COMMON))
        .route("/assets/site.js", file(&SITE_SCRIPT))
        .route("/assets/rod.js", file(&ROD_SCRIPT))
        .route("/assets/alarms.js", file(&ALARMS_SCRIPT))
        .route("/assets/figures.js", file(&FIGURES))
        .route("/assets/style.css", file(&SHEET))
        .route("/assets/icon.svg", file(&ICON))
        .route("/assets/plotly.js", file(&PLOTLY))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plot_library_is_whole() {
        let script = plotly();
        assert!(script.len() > 4_000_000, "{}", script.len());
        assert!(
            script.contains("Plotly") && !script.contains("<script"),
            "a tag was left in"
        );
        assert!(LazyLock::force(&PLOTLY).gzip.len() < 2_000_000);
    }
}
