//! The HTTP listener: few connections, small requests, deadlines.

use super::seats::{CONNECTIONS, Content, Place, Seat, Seats};
use crate::config::settings::http::HttpSettings;
use crate::service::tcp;
use crate::service::telemetry::{Fault, Health, Via};
use axum::Router;
use axum::body::Body;
use axum::http::{Request, Response, StatusCode};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time;

/// Longest time for a request's line and headers, and for the next request of a kept connection.
const READ: Duration = Duration::from_secs(8);

/// Longest time without progress of an answer before the client is cut off.
const WRITE: Duration = Duration::from_secs(8);

/// Most bytes of a request's line and headers.
const HEAD_BYTES: usize = 16 << 10;

/// Most headers of a request.
const HEADERS: usize = 64;

/// Time for answers after the end was requested.
const DRAIN: Duration = Duration::from_secs(1);

/// Pause after the system refused a connection.
const PAUSE: Duration = Duration::from_millis(200);

/// Binds the configured address; `None` for no server.
///
/// # Errors
/// The address is taken, or not this machine's.
pub fn listen(settings: &HttpSettings) -> io::Result<Option<std::net::TcpListener>> {
    let Some(address) = settings.listen else {
        return Ok(None);
    };
    let listener = tcp::bind(address)
        .map_err(|error| io::Error::new(error.kind(), format!("http.listen {address}: {error}")))?;
    Ok(Some(listener))
}

/// Answers until `stop` becomes true.
///
/// # Errors
/// The listener is no socket the runtime can wait on.
pub async fn serve(
    listener: std::net::TcpListener,
    routes: Router,
    health: Arc<Health>,
    mut stop: watch::Receiver<bool>,
) -> io::Result<()> {
    listener.set_nonblocking(true)?;
    let listener = TcpListener::from_std(listener)?;
    let seats = Arc::<Seats>::default();
    let mut open = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            _ = stop.wait_for(|stop| *stop) => break,
            _ = open.join_next(), if !open.is_empty() => continue,
            accepted = listener.accept() => accepted,
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                health.fault(Fault::Refused, format!("http: a connection failed: {error}"));
                time::sleep(PAUSE).await;
                continue;
            }
        };
        let (seat, has_left) = seats.wait(peer.ip());
        if has_left {
            let address = peer.ip();
            let what = format!(
                "http: too many connections that ask nothing, the latest from {address}: the oldest is closed"
            );
            health.fault(Fault::Refused, what);
        }
        let client = Client {
            peer,
            seat: Arc::new(seat),
            health: Arc::clone(&health),
        };
        open.spawn(answer(stream, client, routes.clone(), stop.clone()));
    }
    drop(listener);
    let drained = async { while open.join_next().await.is_some() {} };
    // Connections still open then end with the set.
    let _ = time::timeout(DRAIN, drained).await;
    Ok(())
}

/// The client of a connection.
#[derive(Clone)]
struct Client {
    peer: SocketAddr,
    seat: Arc<Seat>,
    health: Arc<Health>,
}

/// Answers one connection's requests until it closes, breaks a limit, must make room, or the server stops.
async fn answer(stream: TcpStream, client: Client, routes: Router, mut stop: watch::Receiver<bool>) {
    // The system cuts off a client that leaves an answer in the socket's buffer.
    let timeout_ms = u32::try_from(WRITE.as_millis()).unwrap_or(u32::MAX);
    if rustix::net::sockopt::set_tcp_user_timeout(&stream, timeout_ms).is_err() {
        return;
    }
    let seat = Arc::clone(&client.seat);
    let routes = TowerToHyperService::new(routes);
    let service = service_fn(move |request| ask(client.clone(), routes.clone(), request));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(READ)
        .max_buf_size(HEAD_BYTES)
        .max_headers(HEADERS)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    let mut connection = std::pin::pin!(connection);
    // Errors are the client's: it went away, sent no HTTP, or ran out of time; hyper has answered it if possible.
    tokio::select! {
        _ = connection.as_mut() => return,
        () = seat.must_leave() => return,
        _ = stop.wait_for(|stop| *stop) => {}
    }
    connection.as_mut().graceful_shutdown();
    let _ = connection.await;
}

/// Answers one request, if its connection may ask it; reports a refusal to health.
async fn ask(
    client: Client,
    routes: TowerToHyperService<Router>,
    request: Request<Incoming>,
) -> Result<Response<Content>, Infallible> {
    let busy = client.seat.busy();
    let path = request.uri().path();
    let place = client.seat.sit(path);
    let reason = match place {
        Place::Free => None,
        Place::Freed => Some("the one silent longest is closed"),
        Place::Refused => Some("all are busy, a request is turned away"),
    };
    if let Some(reason) = reason {
        let address = client.peer.ip();
        let what =
            format!("http: more than {CONNECTIONS} connections at once, or many from {address}: {reason}");
        client.health.fault(Fault::Refused, what);
    }
    let response = if place != Place::Refused {
        let path: String = path.chars().take(80).collect();
        let response = routes.call(request).await?;
        if matches!(
            response.status(),
            StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN
        ) {
            let (peer, status) = (client.peer, response.status());
            let what =
                format!("http: {peer}: {path:?} is not allowed without the token or from there ({status})");
            client.health.credentials().denied(Via::Http);
            client.health.fault(Fault::Refused, what);
        }
        response
    } else {
        let mut response = Response::new(Body::from("too many connections at once\n"));
        *response.status_mut() = StatusCode::SERVICE_UNAVAILABLE;
        response
    };
    Ok(response.map(|body| Content::new(body, busy)))
}
