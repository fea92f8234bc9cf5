//! A webhook: the documented JSON object posted to a URL.

use super::post::post;
use super::{Failure, Message, Sink};
use crate::config::settings::alert::WebhookSettings;
use std::time::Duration;

/// A webhook.
pub(super) struct Webhook {
    settings: WebhookSettings,
    deadline: Duration,
}

impl Webhook {
    pub(super) fn new(settings: WebhookSettings, deadline: Duration) -> Self {
        Self { settings, deadline }
    }
}

impl Sink for Webhook {
    fn deliver(&mut self, message: &Message) -> Result<(), Failure> {
        let mut headers = vec![("Idempotency-Key", message.id.as_str())];
        let more = self.settings.headers.iter();
        headers.extend(more.map(|(name, value)| (name.as_str(), value.as_str())));
        let target = &self.settings.target;
        post(target, &target.url, &headers, &message.json(), self.deadline)
    }
}
