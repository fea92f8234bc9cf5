//! The HTTP server: the page and its API, health, readiness, metrics.
//!
//! `routes` answers requests; `serve` listens: a limited number of connections, each with limits and
//! deadlines, so that no client can cost the daemon more than a little memory.
//! * `page`    documents, scripts and style (`src/service/http/page/`), the plot library
//! * `api`     `/api/v1`, read-only but for what brings the token
//! * `live`    `/api/v1/events`
//! * `viewer`  `/viewer`, for robotics viewers
//! * `shown`   the store behind both
//! * `access`  access control: host names, tokens
//! * `seats`   limits on connections
//! * `problem` error answers

mod access;
mod api;
mod live;
mod packed;
mod page;
mod problem;
mod routes;
mod seats;
mod serve;
mod shown;
mod viewer;

pub use access::Access;
pub use api::Api;
pub use routes::{documents, routes};
pub use serve::{listen, serve};
pub use shown::{Shown, Unanswered};
