//! Error answers: a status and one sentence, as JSON.

use super::shown::Unanswered;
use crate::site::store::StoreError;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

/// An error answer.
#[derive(Debug)]
pub struct Problem {
    status: StatusCode,
    message: String,
    /// True if the client should ask again in a second.
    is_soon: bool,
}

#[derive(Serialize)]
struct Body<'m> {
    error: &'m str,
}

/// 400: the request is malformed.
pub fn bad(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::BAD_REQUEST,
        message: message.into(),
        is_soon: false,
    }
}

/// 404: there is no such thing.
pub fn missing(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::NOT_FOUND,
        message: message.into(),
        is_soon: false,
    }
}

/// 403: the client may not ask this.
pub fn forbidden(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::FORBIDDEN,
        message: message.into(),
        is_soon: false,
    }
}

/// 401: the request needs a token.
pub fn unauthorized(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::UNAUTHORIZED,
        message: message.into(),
        is_soon: false,
    }
}

/// 503: there is no answer now.
pub fn unavailable(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::SERVICE_UNAVAILABLE,
        message: message.into(),
        is_soon: false,
    }
}

impl From<Unanswered> for Problem {
    fn from(why: Unanswered) -> Self {
        match why {
            Unanswered::Store(error) => error.into(),
            Unanswered::Reading { .. } => Self {
                is_soon: true,
                ..unavailable(why.to_string())
            },
        }
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        unavailable(error.to_string())
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let body = Body { error: &self.message };
        let text = serde_json::to_string(&body).unwrap_or_default() + "\n";
        let kind = [(header::CONTENT_TYPE, "application/json")];
        let again = self.is_soon.then_some([(header::RETRY_AFTER, "1")]);
        (self.status, kind, again, text).into_response()
    }
}

/// Longest refusal in plain text that is read \[bytes\].
const LONGEST: usize = 16 * 1024;

/// An answer of the API as all are: a refusal in plain text, such as of a query that cannot be parsed, becomes a [`Problem`].
pub async fn as_json(answer: Response) -> Response {
    let status = answer.status();
    let kind = answer.headers().get(header::CONTENT_TYPE);
    let is_json = kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/json"));
    if is_json || !(status.is_client_error() || status.is_server_error()) {
        return answer;
    }
    let (mut parts, body) = answer.into_parts();
    let text = axum::body::to_bytes(body, LONGEST).await.unwrap_or_default();
    let text = String::from_utf8_lossy(&text).trim().to_owned();
    let problem = Problem {
        status,
        message: if text.is_empty() { status.to_string() } else { text },
        is_soon: false,
    };
    // Such as the methods that are allowed.
    for name in [header::CONTENT_TYPE, header::CONTENT_LENGTH] {
        parts.headers.remove(name);
    }
    let mut answer = problem.into_response();
    answer.headers_mut().extend(parts.headers);
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_should_ask_again_is_told_when() {
        let soon: Problem = Unanswered::Reading { share: 0.426 }.into();
        assert!(soon.message.contains("43 %"), "{}", soon.message);
        let answer = soon.into_response();
        assert_eq!(answer.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(answer.headers()[header::RETRY_AFTER], "1");
        let answer = unavailable("no").into_response();
        assert!(!answer.headers().contains_key(header::RETRY_AFTER));
    }
}
