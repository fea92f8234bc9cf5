//! Assigns channels to rods: one plan for all channels of one topic, encoding and schema.

use super::decode::{DecodeError, Decoder, SchemaRef};
use super::mcap::ChannelInfo;
use std::collections::HashMap;
use std::sync::Arc;
use tirante_analysis::signal::record::RodChannels;

/// Most bytes of all plans of a file.
const MOST: usize = 16 << 20;

/// One quantity of one rod on one channel.
pub(super) struct Route {
    pub rod: usize,
    pub temperature: bool,
    pub decoder: Result<Decoder, DecodeError>,
}

/// Plans of a file's channels.
#[derive(Default)]
pub(super) struct Plans {
    /// Plans by topic, encoding and id of the schema.
    known: HashMap<(String, String, u16), Arc<[Route]>>,
    bytes: usize,
}

impl Plans {
    /// Quantities of `rods` on a channel; `None` if no rod reads it.
    pub fn routes<'a>(
        &mut self,
        rods: impl Iterator<Item = &'a RodChannels>,
        channel: &ChannelInfo,
        schema: Option<SchemaRef<'_>>,
    ) -> Option<Arc<[Route]>> {
        let mut wanted = Vec::new();
        for (rod, config) in rods.enumerate() {
            let quantities = [
                (Some(&config.displacement), false),
                (config.temperature.as_ref(), true),
            ];
            for (quantity, temperature) in quantities {
                let quantity = quantity.filter(|quantity| quantity.topic == channel.topic);
                wanted.extend(quantity.map(|quantity| (rod, temperature, quantity)));
            }
        }
        if wanted.is_empty() {
            return None;
        }
        let key = (channel.topic.clone(), channel.encoding.clone(), channel.schema);
        if let Some(routes) = self.known.get(&key) {
            return Some(Arc::clone(routes));
        }
        let routes = wanted.into_iter().map(|(rod, temperature, quantity)| {
            let decoder = if self.bytes > MOST {
                Err(DecodeError::Schema(
                    "more message definitions for the topics of rods than any recorder writes".to_owned(),
                ))
            } else {
                Decoder::compile(&channel.encoding, schema, &quantity.field, &quantity.time)
            };
            self.bytes += size_of::<Route>() + decoder.as_ref().map_or(0, Decoder::bytes);
            Route {
                rod,
                temperature,
                decoder,
            }
        });
        let routes: Arc<[Route]> = routes.collect::<Vec<_>>().into();
        self.known.insert(key, Arc::clone(&routes));
        Some(routes)
    }
}
