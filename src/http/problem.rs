//! What is answered when there is no answer: a status and one sentence, as JSON.

use crate::store::StoreError;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

/// A refusal.
#[derive(Debug)]
pub struct Problem {
    status: StatusCode,
    message: String,
}

#[derive(Serialize)]
struct Body<'m> {
    error: &'m str,
}

/// The question was wrong.
pub fn bad(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::BAD_REQUEST,
        message: message.into(),
    }
}

/// There is no such thing.
pub fn missing(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::NOT_FOUND,
        message: message.into(),
    }
}

/// It needs a token.
pub fn forbidden(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::UNAUTHORIZED,
        message: message.into(),
    }
}

/// Not now.
pub fn unavailable(message: impl Into<String>) -> Problem {
    Problem {
        status: StatusCode::SERVICE_UNAVAILABLE,
        message: message.into(),
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
        (self.status, kind, text).into_response()
    }
}
