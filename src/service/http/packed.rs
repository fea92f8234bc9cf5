//! Compresses answers, and omits those that the client already has.

use crate::site::hex::hex;
use axum::body::{Body, Bytes, to_bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest, Sha256};
use std::io::Write;

/// Least size of an answer that is compressed \[bytes\]: below it the packet would hardly shrink.
const SHORTEST: usize = 1024;

/// Compresses data; empty on failure.
pub(super) fn gzip(plain: &[u8], level: Compression) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), level);
    // Writing to memory cannot fail; without a compressed form the plain one is sent.
    encoder
        .write_all(plain)
        .and_then(|()| encoder.finish())
        .unwrap_or_default()
}

/// Entity tag computed from the content.
pub(super) fn tag(plain: &[u8]) -> String {
    let hash = Sha256::digest(plain);
    let digits = hex(&hash[..8]);
    // Weak: it stands for the plain and for the compressed answer.
    format!("W/\"{digits}\"")
}

/// True if the client has the answer with this tag.
pub(super) fn has(asked: &HeaderMap, tag: &str) -> bool {
    said(asked, header::IF_NONE_MATCH).is_some_and(|tags| {
        let of = |one: &str| one.trim().trim_start_matches("W/").to_owned();
        tags.split(',').any(|one| of(one) == of(tag))
    })
}

/// True if the client accepts gzip.
pub(super) fn takes_gzip(asked: &HeaderMap) -> bool {
    said(asked, header::ACCEPT_ENCODING).is_some_and(|list| {
        list.split(',').any(|one| {
            let mut parts = one.split(';').map(str::trim);
            let refuses = |part: &str| part.strip_prefix("q=").and_then(|q| q.parse().ok()) == Some(0.0);
            parts.next() == Some("gzip") && !parts.any(refuses)
        })
    })
}

fn said(asked: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    asked.get(name).and_then(|value| value.to_str().ok())
}

/// Adds the headers that let a client keep an answer and ask if it is still valid.
pub(super) fn mark(headers: &mut HeaderMap, tag: &str) {
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    if let Ok(tag) = HeaderValue::from_str(tag) {
        headers.insert(header::ETAG, tag);
    }
}

/// Tags the answer to a GET or HEAD request, omits it if the client has it, and compresses it otherwise.
pub(super) async fn pack(mut request: Request, next: Next) -> Response {
    let asked = request.headers().clone();
    // A HEAD is answered as its GET: tag and length are those of the body, which the router leaves out at the end.
    if request.method() == Method::HEAD {
        *request.method_mut() = Method::GET;
    }
    let is_question = request.method() == Method::GET;
    let response = next.run(request).await;
    if !is_question || response.status() != StatusCode::OK {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    // Answers are whole in memory: this takes them out of their wrapping.
    let Ok(plain) = to_bytes(body, usize::MAX).await else {
        return StatusCode::INTERNAL_SERVER_ERROR.into_response();
    };
    let tag = tag(&plain);
    mark(&mut parts.headers, &tag);
    if has(&asked, &tag) {
        parts.status = StatusCode::NOT_MODIFIED;
        return Response::from_parts(parts, Body::empty());
    }
    let body = if plain.len() >= SHORTEST && takes_gzip(&asked) {
        let whole = plain.clone();
        let packed = tokio::task::spawn_blocking(move || gzip(&whole, Compression::fast())).await;
        let packed = packed.unwrap_or_default();
        if packed.is_empty() {
            plain
        } else {
            parts
                .headers
                .insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
            Bytes::from(packed)
        }
    } else {
        plain
    };
    Response::from_parts(parts, Body::from(body))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_sent_to_those_who_take_it() {
        for (list, takes) in [
            ("gzip, deflate, br", true),
            ("br;q=1.0, gzip;q=0.8", true),
            ("gzip;q=0", false),
            ("identity", false),
        ] {
            let mut asked = HeaderMap::new();
            asked.insert(header::ACCEPT_ENCODING, HeaderValue::from_static(list));
            assert_eq!(takes_gzip(&asked), takes, "{list}");
        }
    }
}
