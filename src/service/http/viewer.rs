//! `/viewer`: the live view of robotics viewers (Foxglove, Lichtblick) over a WebSocket. One task per viewer asks the store
//! itself when the bell rings, so that a slow viewer delays no other and fills no queue.

use super::api::Api;
use super::live::LISTENERS;
use super::problem::{self, Problem};
use super::shown::Shown;
use crate::service::viewer::protocol::{self, Request, Subscription};
use crate::service::viewer::{self, Ear, Feed, Heard, Message, Topic};
use crate::site::clock;
use crate::site::store::{Reader, StoreError};
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message as Frame, WebSocket, WebSocketUpgrade};
use axum::http::HeaderMap;
use axum::response::Response;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::time;

/// Most bytes of a viewer's message: the subscriptions of some thousand topics.
const REQUEST_BYTES: usize = 256 << 10;

/// Longest time without progress before a viewer is cut off.
const WRITE: Duration = Duration::from_secs(8);

/// Interval of pings to a silent viewer, and the most answers it may owe.
const ALIVE: Duration = Duration::from_secs(15);
const OWED: u32 = 3;

/// Opens the live view, for viewers that speak its protocol and, if they are web pages, come from an allowed
/// origin.
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
            ear: api.signals.listen(),
            unheard: 0,
            feed: None,
            channels: Vec::new(),
            numbers: BTreeMap::new(),
            subscriptions: BTreeMap::new(),
            awaited: BTreeSet::new(),
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
    /// Place among the listeners to the signals of a daemon; `serve` has none.
    ear: Ear,
    /// Number of samples that were left out and not reported yet.
    unheard: usize,
    feed: Option<Feed>,
    /// Advertised topics; the index is the channel's number.
    channels: Vec<Topic>,
    numbers: BTreeMap<Topic, u32>,
    /// The viewer's own number of its subscription, at most one per topic.
    subscriptions: BTreeMap<Topic, u32>,
    /// Topics subscribed to whose present state was not sent yet.
    awaited: BTreeSet<Topic>,
    /// Number of pings without an answer.
    owed: u32,
}

impl Viewer {
    /// Sends the present state and then changes, until the viewer leaves.
    async fn serve(&mut self) -> Result<(), Gone> {
        let mut bell = self.shown.bell();
        let name = concat!("tirante ", env!("CARGO_PKG_VERSION"));
        self.say(protocol::server_info(name)).await?;
        // The protocol wants one, were there nothing yet.
        self.say(protocol::advertise([])).await?;
        self.look().await?;
        let mut alive = time::interval_at(time::Instant::now() + ALIVE, ALIVE);
        alive.set_missed_tick_behavior(time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                rang = bell.changed() => {
                    rang.map_err(|_| Gone)?;
                    self.look().await?;
                }
                heard = self.ear.next() => self.pass_on(heard).await?,
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
                    self.report_unheard().await?;
                    self.send(Frame::Ping(Vec::new().into())).await?;
                    // A request without an answer when the bell rang may have one now.
                    self.look().await?;
                }
            }
        }
    }

    /// Queries the store for changes: advertises new rods, sends messages of subscribed topics, and the
    /// present state of topics subscribed since or unanswered before. One query for all, so that nothing is
    /// sent twice or missed.
    async fn look(&mut self) -> Result<(), Gone> {
        let mut wanted: BTreeSet<Topic> = self.subscriptions.keys().cloned().collect();
        wanted.retain(|topic| !self.awaited.contains(topic));
        let awaited = self.awaited.clone();
        let question = move |reader: &Reader, feed: &mut Feed| {
            let topics = Feed::topics(reader)?;
            let mut standing = Vec::new();
            for topic in &awaited {
                standing.extend(viewer::standing(reader, topic)?);
            }
            let news = feed.news(reader, &wanted)?;
            feed.told(&standing);
            Ok((topics, news, standing))
        };
        let Some((topics, news, standing)) = self.ask(question).await? else {
            return Ok(());
        };
        self.awaited.clear();
        self.advertise(topics.into_iter().chain(self.ear.topics()).collect())
            .await?;
        if news.is_other_store {
            let why = "another store took the place of the one that was followed";
            self.say(protocol::warning(why)).await?;
        }
        if news.left_out > 0 {
            let why = format!(
                "{} records or news of alarms came at once and are left out",
                news.left_out
            );
            self.say(protocol::warning(&why)).await?;
        }
        for message in news.messages.iter().chain(&standing) {
            if let Some(&id) = self.subscriptions.get(&message.topic) {
                self.tell(id, message).await?;
            }
        }
        Ok(())
    }

    /// Advertises the new ones of these topics.
    async fn advertise(&mut self, topics: Vec<Topic>) -> Result<(), Gone> {
        let known = self.channels.len();
        for topic in topics {
            let Ok(number) = u32::try_from(self.channels.len()) else {
                break;
            };
            if !self.numbers.contains_key(&topic) {
                self.numbers.insert(topic.clone(), number);
                self.channels.push(topic);
            }
        }
        if self.channels.len() == known {
            return Ok(());
        }
        let text = protocol::advertise((0..).zip(&self.channels).skip(known));
        self.say(text).await
    }

    /// Handles a request of the viewer.
    async fn take(&mut self, text: &str) -> Result<(), Gone> {
        match serde_json::from_str(text) {
            Ok(Request::Subscribe { subscriptions }) => {
                for subscription in subscriptions {
                    self.subscribe(subscription).await?;
                }
                Ok(())
            }
            Ok(Request::Unsubscribe { subscription_ids }) => {
                self.subscriptions.retain(|_, id| !subscription_ids.contains(id));
                let subscriptions = &self.subscriptions;
                self.awaited.retain(|topic| subscriptions.contains_key(topic));
                self.tune();
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

    /// Adds one subscription, if the protocol allows it.
    async fn subscribe(&mut self, Subscription { id, channel_id }: Subscription) -> Result<(), Gone> {
        let place = usize::try_from(channel_id).unwrap_or(usize::MAX);
        let why = match self.channels.get(place).cloned() {
            None => format!("there is no channel {channel_id}"),
            Some(topic) if self.subscriptions.contains_key(&topic) => {
                format!("channel {channel_id} is subscribed to already")
            }
            Some(_) if self.subscriptions.values().any(|known| *known == id) => {
                format!("subscription {id} is of another channel")
            }
            Some(topic) => {
                self.subscriptions.insert(topic.clone(), id);
                self.tune();
                self.awaited.insert(topic);
                return self.look().await;
            }
        };
        self.say(protocol::warning(&why)).await
    }

    /// Listens to the signals subscribed to.
    fn tune(&self) {
        let signal = |topic: &Topic| match topic {
            Topic::Signal(rod) => Some(rod.clone()),
            _ => None,
        };
        self.ear
            .want(self.subscriptions.keys().filter_map(signal).collect());
    }

    /// Sends samples of the signals subscribed to.
    async fn pass_on(&mut self, heard: Heard) -> Result<(), Gone> {
        self.unheard += heard.left_out;
        for message in &heard.messages {
            if let Some(&id) = self.subscriptions.get(&message.topic) {
                self.tell(id, message).await?;
            }
        }
        Ok(())
    }

    /// Reports samples that were left out, with every sign of life at most.
    async fn report_unheard(&mut self) -> Result<(), Gone> {
        if self.unheard == 0 {
            return Ok(());
        }
        let why = format!(
            "{} samples came faster than this viewer took them and are left out of the live signal",
            std::mem::take(&mut self.unheard)
        );
        self.say(protocol::warning(&why)).await
    }

    /// Queries the store on a blocking thread; `None` if it has no answer now, of which the viewer is
    /// notified.
    async fn ask<T: Send + 'static>(
        &mut self,
        question: impl FnOnce(&Reader, &mut Feed) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<Option<T>, Gone> {
        let (shown, mut feed) = (Arc::clone(&self.shown), self.feed.take());
        let work = move || {
            let answer = shown.read(|reader| {
                let feed = match &mut feed {
                    Some(feed) => feed,
                    none => none.insert(Feed::new(reader)?),
                };
                question(reader, feed)
            });
            (feed, answer)
        };
        let (feed, answer) = tokio::task::spawn_blocking(work).await.map_err(|_| Gone)?;
        self.feed = feed;
        match answer {
            Ok(answer) => Ok(Some(answer)),
            Err(error) => {
                self.say(protocol::warning(&error.to_string())).await?;
                Ok(None)
            }
        }
    }

    /// Sends a message under a subscription.
    async fn tell(&mut self, id: u32, message: &Message) -> Result<(), Gone> {
        let frame = protocol::message(id, clock::now(), message);
        self.send(Frame::Binary(frame.into())).await
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
