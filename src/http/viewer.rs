//! `/viewer`: the live view of robotics viewers (Foxglove, Lichtblick) over a WebSocket. One task per viewer asks the store
//! itself when the bell rings, so that a slow viewer holds up nobody and fills no queue.

use super::api::Api;
use super::live::LISTENERS;
use super::problem::{self, Problem};
use super::shown::Shown;
use crate::clock;
use crate::store::{Reader, StoreError};
use crate::viewer::protocol::{self, Request};
use crate::viewer::{Feed, Message, Topic};
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message as Frame, WebSocket, WebSocketUpgrade};
use axum::http::HeaderMap;
use axum::response::Response;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::time;

/// Most bytes a viewer says at once: the subscriptions of some thousand topics.
const REQUEST_BYTES: usize = 256 << 10;

/// A viewer that takes nothing for this long is cut off.
const WRITE: Duration = Duration::from_secs(8);

/// How often a silent viewer is asked whether it lives, and how many answers it may owe.
const ALIVE: Duration = Duration::from_secs(15);
const OWED: u32 = 3;

/// Most subscriptions of a viewer.
const SUBSCRIPTIONS: usize = 4096;

/// The live view, for viewers that speak its protocol and, if they are web pages, come from an origin that may.
pub async fn open(
    State(api): State<Api>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let upgrade = upgrade.map_err(|error| problem::bad(format!("viewers speak WebSocket here: {error}")))?;
    api.access.may_view(&headers).map_err(|origin| {
        problem::forbidden(format!(
            "pages of {origin} may not open the live view: put it into http.viewer_origins of the configuration"
        ))
    })?;
    let upgrade = upgrade
        .protocols(protocol::SUBPROTOCOLS)
        .max_message_size(REQUEST_BYTES)
        .max_frame_size(REQUEST_BYTES);
    if upgrade.selected_protocol().is_none() {
        let known = protocol::SUBPROTOCOLS.join(" or ");
        return Err(problem::bad(format!("the live view speaks {known}")));
    }
    let place = Arc::clone(&api.listeners)
        .try_acquire_owned()
        .map_err(|_| problem::unavailable(format!("{LISTENERS} pages and viewers listen already")))?;
    Ok(upgrade.on_upgrade(async move |socket| {
        let mut stop = api.stop.clone();
        let mut viewer = Viewer {
            socket,
            shown: api.shown,
            feed: None,
            channels: Vec::new(),
            subscriptions: BTreeMap::new(),
            owed: 0,
        };
        // Why a viewer goes is its own affair: it closed, broke, or took nothing any more.
        tokio::select! {
            _ = viewer.serve() => {}
            _ = stop.wait_for(|stop| *stop) => {}
        }
        drop(place);
    }))
}

/// The viewer is gone.
struct Gone;

/// One viewer's connection.
struct Viewer {
    socket: WebSocket,
    shown: Arc<Shown>,
    feed: Option<Feed>,
    /// What was advertised; a channel's number is its place.
    channels: Vec<Topic>,
    /// The channel's place by the viewer's own number.
    subscriptions: BTreeMap<u32, usize>,
    /// Pings without an answer.
    owed: u32,
}

impl Viewer {
    /// Says what there is, and then what is new, until the viewer goes.
    async fn serve(&mut self) -> Result<(), Gone> {
        let mut bell = self.shown.bell();
        let name = concat!("tirante ", env!("CARGO_PKG_VERSION"));
        self.say(protocol::server_info(name)).await?;
        self.look().await?;
        let mut alive = time::interval_at(time::Instant::now() + ALIVE, ALIVE);
        loop {
            tokio::select! {
                rang = bell.changed() => {
                    rang.map_err(|_| Gone)?;
                    bell.mark_unchanged();
                    self.look().await?;
                }
                frame = self.socket.recv() => {
                    self.owed = 0;
                    match frame {
                        Some(Ok(Frame::Text(text))) => self.take(&text).await?,
                        Some(Ok(Frame::Binary(_) | Frame::Ping(_) | Frame::Pong(_))) => {}
                        Some(Ok(Frame::Close(_)) | Err(_)) | None => return Err(Gone),
                    }
                }
                _ = alive.tick() => {
                    if self.owed == OWED {
                        return Err(Gone);
                    }
                    self.owed += 1;
                    self.send(Frame::Ping(Vec::new().into())).await?;
                }
            }
        }
    }

    /// Asks the store what is new; advertises rods that are new and tells what was subscribed to.
    async fn look(&mut self) -> Result<(), Gone> {
        let wanted: BTreeSet<Topic> = self
            .subscriptions
            .values()
            .filter_map(|place| self.channels.get(*place).cloned())
            .collect();
        let question =
            move |reader: &Reader, feed: &mut Feed| Ok((Feed::topics(reader)?, feed.news(reader, &wanted)?));
        let Some((topics, news)) = self.ask(question).await? else {
            return Ok(());
        };
        let known = self.channels.len();
        for topic in topics {
            if !self.channels.contains(&topic) {
                self.channels.push(topic);
            }
        }
        let new = self.channels.iter().enumerate().skip(known);
        let new: Vec<_> = new
            .filter_map(|(place, topic)| Some((u32::try_from(place).ok()?, topic)))
            .collect();
        if !new.is_empty() {
            let text = protocol::advertise(new);
            self.say(text).await?;
        }
        for message in news {
            self.tell(&message).await?;
        }
        Ok(())
    }

    /// Does what the viewer asks for.
    async fn take(&mut self, text: &str) -> Result<(), Gone> {
        match serde_json::from_str(text) {
            Ok(Request::Subscribe { subscriptions }) => {
                for subscription in subscriptions {
                    let place = usize::try_from(subscription.channel_id).unwrap_or(usize::MAX);
                    let Some(topic) = self.channels.get(place).cloned() else {
                        let why = format!("there is no channel {}", subscription.channel_id);
                        self.say(protocol::warning(&why)).await?;
                        continue;
                    };
                    if self.subscriptions.len() >= SUBSCRIPTIONS {
                        let why = format!("{SUBSCRIPTIONS} subscriptions at most");
                        self.say(protocol::warning(&why)).await?;
                        continue;
                    }
                    self.subscriptions.insert(subscription.id, place);
                    let question = move |reader: &Reader, feed: &mut Feed| feed.standing(reader, &topic);
                    for message in self.ask(question).await?.unwrap_or_default() {
                        let frame = protocol::message(subscription.id, clock::now(), &message);
                        self.send(Frame::Binary(frame.into())).await?;
                    }
                }
                Ok(())
            }
            Ok(Request::Unsubscribe { subscription_ids }) => {
                for id in subscription_ids {
                    self.subscriptions.remove(&id);
                }
                Ok(())
            }
            Ok(Request::Other) => {
                let why = "this server tells what was committed and takes nothing";
                self.say(protocol::warning(why)).await
            }
            Err(error) => {
                let why = format!("a request was not understood: {error}");
                self.say(protocol::warning(&why)).await
            }
        }
    }

    /// Asks the store on a thread that may wait; `None` if it has no answer now, of which the viewer is told.
    async fn ask<T: Send + 'static>(
        &mut self,
        question: impl FnOnce(&Reader, &mut Feed) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<Option<T>, Gone> {
        let (shown, feed) = (Arc::clone(&self.shown), self.feed.take());
        let work = move || {
            shown.read(|reader| {
                let mut feed = match feed {
                    Some(feed) => feed,
                    None => Feed::new(reader)?,
                };
                let answer = question(reader, &mut feed);
                Ok((feed, answer))
            })
        };
        let answer = tokio::task::spawn_blocking(work).await.map_err(|_| Gone)?;
        let answer = answer.and_then(|(feed, answer)| {
            self.feed = Some(feed);
            answer
        });
        match answer {
            Ok(answer) => Ok(Some(answer)),
            Err(error) => {
                self.say(protocol::warning(&error.to_string())).await?;
                Ok(None)
            }
        }
    }

    /// A message under each subscription of its topic.
    async fn tell(&mut self, message: &Message) -> Result<(), Gone> {
        let told = clock::now();
        let frames: Vec<Vec<u8>> = self
            .subscriptions
            .iter()
            .filter(|(_, place)| self.channels.get(**place) == Some(&message.topic))
            .map(|(id, _)| protocol::message(*id, told, message))
            .collect();
        for frame in frames {
            self.send(Frame::Binary(frame.into())).await?;
        }
        Ok(())
    }

    async fn say(&mut self, text: String) -> Result<(), Gone> {
        self.send(Frame::Text(text.into())).await
    }

    async fn send(&mut self, frame: Frame) -> Result<(), Gone> {
        match time::timeout(WRITE, self.socket.send(frame)).await {
            Ok(Ok(())) => Ok(()),
            _ => Err(Gone),
        }
    }
}
