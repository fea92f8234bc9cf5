//! The HTTP server: the page and its API, health, readiness, metrics.
//!
//! [`routes`] is what it answers; [`serve`] is how it listens: at most so many connections, each with limits and deadlines, so
//! that no client can cost the daemon more than a little memory.
//! * `page`    documents, scripts and style (`src/service/http/page/`)
//! * `packed`  compression, entity tags
//! * `api`     `/api/v1`, read-only but for what brings the token
//! * `live`    `/api/v1/events`
//! * `viewer`  `/viewer`, for robotics viewers
//! * `shown`   the store behind both
//! * `access`  who may ask, who may change something
//! * `seats`   which connection may stay when there are many
//! * `problem` what is answered when there is no answer

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
pub use routes::routes;
pub use serve::{listen, serve};
pub use shown::{Shown, Unanswered};
