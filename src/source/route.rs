//! From a file's channels to the rods: which messages mean what, decoded and handed to the assemblers.

use super::decode::{DecodeError, Decoded, Decoder, SchemaRef, Time};
use super::mcap::{ChannelInfo, Item, Message};
use super::summary::{Summary, TopicSummary};
use crate::record::{
    Assembler, Channel, Event, RecordSettings, Rejection, RodChannels, TimeSource, Timestamp,
};

/// Everything between messages and events for one file.
pub(super) struct Router {
    rods: Vec<Rod>,
    /// By channel id.
    channels: Vec<Listed>,
    scratch: Vec<f64>,
    topics: Vec<(String, TopicSummary)>,
    unverified: bool,
}

struct Rod {
    config: RodChannels,
    assembler: Assembler,
    messages: u64,
}

#[derive(Default)]
struct Listed {
    /// Index into the topics.
    topic: usize,
    known: bool,
    routes: Vec<Route>,
}

/// One quantity of one rod on one channel.
struct Route {
    rod: usize,
    temperature: bool,
    decoder: Result<Decoder, DecodeError>,
}

impl Router {
    pub fn new(rods: &[RodChannels], settings: &RecordSettings) -> Self {
        let rods = rods.iter().map(|config| {
            let temperature = config.temperature.is_some();
            let fs_hz = config.displacement.fs_hz;
            Rod {
                config: config.clone(),
                assembler: Assembler::new(config.rod.clone(), *settings, fs_hz, temperature),
                messages: 0,
            }
        });
        Self {
            rods: rods.collect(),
            channels: Vec::new(),
            scratch: Vec::new(),
            topics: Vec::new(),
            unverified: false,
        }
    }

    /// Takes what the reader hands out.
    pub fn item(&mut self, item: Item<'_>) {
        match item {
            Item::Message(message) => self.message(message),
            Item::Channel(id, channel, schema) => self.channel(id, channel, schema),
            Item::Unverified => {
                self.unverified = true;
                self.rods
                    .iter_mut()
                    .for_each(|rod| rod.assembler.mark_unverified());
            }
        }
    }

    fn channel(&mut self, id: u16, channel: &ChannelInfo, schema: Option<SchemaRef<'_>>) {
        let known = self.topics.iter().position(|(topic, _)| *topic == channel.topic);
        let topic = known.unwrap_or_else(|| {
            let summary = TopicSummary {
                encoding: channel.encoding.clone(),
                ..Default::default()
            };
            self.topics.push((channel.topic.clone(), summary));
            self.topics.len() - 1
        });
        let mut routes = Vec::new();
        for (rod, Rod { config, .. }) in self.rods.iter().enumerate() {
            let quantities = [
                (Some(&config.displacement), false),
                (config.temperature.as_ref(), true),
            ];
            for (wanted, temperature) in quantities {
                let Some(wanted) = wanted.filter(|wanted| wanted.topic == channel.topic) else {
                    continue;
                };
                let decoder = Decoder::compile(&channel.encoding, schema, &wanted.field, &wanted.time);
                routes.push(Route {
                    rod,
                    temperature,
                    decoder,
                });
            }
        }
        let id = usize::from(id);
        if self.channels.len() <= id {
            self.channels.resize_with(id + 1, Listed::default);
        }
        self.channels[id] = Listed {
            topic,
            known: true,
            routes,
        };
    }

    #[inline]
    fn message(&mut self, message: Message<'_>) {
        let Self {
            rods,
            channels,
            scratch,
            topics,
            ..
        } = self;
        let Some(listed) = channels
            .get(usize::from(message.channel))
            .filter(|listed| listed.known)
        else {
            return;
        };
        let Some((_, summary)) = topics.get_mut(listed.topic) else {
            return;
        };
        summary.messages += 1;
        let mut fault = None;
        for route in &listed.routes {
            let Some(rod) = rods.get_mut(route.rod) else {
                continue;
            };
            if let Err(found) = route.take(rod, &message, scratch) {
                fault.get_or_insert(found);
            }
        }
        if let Some(fault) = fault {
            summary.undecodable += 1;
            summary.fault.get_or_insert_with(|| fault.to_string());
        }
    }

    /// What became of the samples so far.
    pub fn events(&mut self, to: &mut impl Extend<Event>) {
        for rod in &mut self.rods {
            to.extend(rod.assembler.events());
        }
    }

    /// Ends every stream; `damage` stands for what was not read, one rejection for each rod the file had
    /// messages of.
    pub fn finish(&mut self, cut_short: bool, damage: Option<&str>, to: &mut impl Extend<Event>) {
        for rod in &mut self.rods {
            rod.assembler.finish(cut_short);
            to.extend(rod.assembler.events());
            let readings = rod.assembler.leftover(Timestamp::MAX);
            if !readings.is_empty() {
                to.extend([Event::Readings {
                    rod: rod.config.rod.clone(),
                    readings,
                }]);
            }
            let rejection = match damage {
                Some(detail) if rod.messages > 0 => Rejection::Damaged {
                    detail: detail.to_owned(),
                },
                // Messages there were, samples none: one offered record that gave nothing.
                None if rod.messages > 0 && rod.assembler.samples() == 0 => Rejection::Missing {
                    share: 1.0,
                    allowed: 0.0,
                },
                _ => continue,
            };
            to.extend([Event::Rejected {
                rod: rod.config.rod.clone(),
                start: None,
                duration_s: 0.0,
                rejection,
            }]);
        }
    }

    /// Fills in what the messages said.
    pub fn summarise(&self, summary: &mut Summary) {
        summary.unverified = self.unverified;
        summary.topics = self.topics.iter().cloned().collect();
        summary.missing.clear();
        for Rod {
            config, assembler, ..
        } in &self.rods
        {
            summary.samples.insert(config.rod.clone(), assembler.samples());
            let wanted = [Some(&config.displacement), config.temperature.as_ref()];
            for Channel { topic, .. } in wanted.into_iter().flatten() {
                if !summary.topics.contains_key(topic) {
                    summary.missing.push((config.rod.clone(), topic.clone()));
                }
            }
        }
    }
}

impl Route {
    #[inline]
    fn take(&self, rod: &mut Rod, message: &Message<'_>, scratch: &mut Vec<f64>) -> Result<(), DecodeError> {
        let channel = match &rod.config.temperature {
            Some(channel) if self.temperature => channel,
            _ => &rod.config.displacement,
        };
        rod.messages += u64::from(!self.temperature);
        let decoder = self.decoder.as_ref().map_err(Clone::clone)?;
        scratch.clear();
        let Decoded { array, time } = decoder.decode(message.data, scratch)?;
        let time = match (time, &channel.time) {
            (Time::Nanos(nanos), _) => nanos,
            (Time::Outside, stamped) => {
                let nanos = match stamped {
                    TimeSource::Publish => message.publish_time,
                    TimeSource::Log | TimeSource::Field(_) => message.log_time,
                };
                i64::try_from(nanos).map_err(|_| DecodeError::Stamp { nanos })?
            }
        };
        let time = Timestamp::from_nanos(time);
        let unit = channel.unit;
        if self.temperature {
            for &raw in scratch.iter() {
                rod.assembler.push_temperature(time, unit.convert(raw));
            }
            return Ok(());
        }
        if array && channel.fs_hz.is_none() {
            return Err(DecodeError::Rate {
                path: channel.field.clone(),
            });
        }
        for sample in scratch.iter_mut() {
            *sample = unit.convert(*sample);
        }
        rod.assembler.push(time, scratch);
        Ok(())
    }
}
