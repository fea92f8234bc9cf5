//! State that remains open after a part of a journal was read to its end: samples not yet in a record.

use super::route::Router;
use serde::{Deserialize, Serialize};
use tirante_analysis::signal::record::{Assembler, RecordSettings, RodChannels, RodId};

/// Version of the encoding, raised whenever the content of an assembler changes its meaning.
const VERSION: u32 = 4;

#[derive(Serialize, Deserialize)]
struct Saved {
    version: u32,
    journal: Option<String>,
    unverified: bool,
    rods: Vec<SavedRod>,
}

#[derive(Serialize, Deserialize)]
struct SavedRod {
    rod: RodId,
    /// Channels and settings with which its samples were cut.
    cut_by: String,
    messages: u64,
    fed_by: [Option<String>; 2],
    assembler: Vec<u8>,
}

/// Records that wait for other sensors of a rod; behind the rest, with the growth since the memory was checked: a restart must not change
/// when it is checked next.
#[derive(Serialize, Deserialize)]
struct SavedMoments {
    rod: RodId,
    /// Of each sensor, as in [`SavedRod`].
    cut_by: Vec<String>,
    moments: Vec<u8>,
}

/// Channels and settings of all sensors of a rod, whose first lane has this number.
fn all_cut_by(router: &Router, first: usize, settings: &RecordSettings) -> Vec<String> {
    let rest = router.rods.iter().skip(first + 1);
    let lanes = router.rods.get(first).into_iter();
    lanes
        .chain(rest.take_while(|rod| rod.sensor > 0))
        .map(|rod| cut_by(&rod.config, settings))
        .collect()
}

/// Channels and settings with which a rod's samples are cut, as a text to compare.
pub(super) fn cut_by(channels: &RodChannels, settings: &RecordSettings) -> String {
    serde_json::to_string(&(channels, settings)).unwrap_or_default()
}

/// Encodes the state of a router whose events were taken.
pub(super) fn encode(router: &Router, settings: &RecordSettings) -> Result<Vec<u8>, postcard::Error> {
    let rods = router.rods.iter().enumerate().map(|(at, rod)| {
        Ok(SavedRod {
            rod: rod.config.rod.clone(),
            cut_by: cut_by(&rod.config, settings),
            messages: router.messages_of(at),
            fed_by: router.fed_by(rod),
            assembler: rod.assembler.save()?,
        })
    });
    let mut body = postcard::to_stdvec(&Saved {
        version: VERSION,
        journal: router.journal.clone(),
        unverified: router.unverified,
        rods: rods.collect::<Result<_, postcard::Error>>()?,
    })?;
    let moments = router.rods.iter().enumerate().filter_map(|(at, rod)| {
        let moments = rod.moments.as_ref()?;
        Some(moments.save().map(|moments| SavedMoments {
            rod: rod.config.rod.clone(),
            cut_by: all_cut_by(router, at, settings),
            moments,
        }))
    });
    let moments: Vec<SavedMoments> = moments.collect::<Result<_, postcard::Error>>()?;
    body.extend(postcard::to_stdvec(&(moments, router.grown))?);
    Ok(body)
}

/// Restores a router from its encoded state, with a sentence for everything that could not be restored.
pub(super) fn decode(
    body: &[u8],
    channels: &[RodChannels],
    settings: &RecordSettings,
) -> (Router, Vec<String>) {
    let mut router = Router::new(channels, settings);
    // The version comes first: a carry of another version need not be readable beyond it.
    let is_ours = postcard::take_from_bytes::<u32>(body).is_ok_and(|(version, _)| version == VERSION);
    let saved = if is_ours {
        postcard::take_from_bytes::<Saved>(body).ok()
    } else {
        None
    };
    let Some((saved, rest)) = saved else {
        let lost = "the open samples of the journal's last part come from another version of the program; they are left out";
        return (router, vec![lost.to_owned()]);
    };
    router.journal = saved.journal;
    router.unverified = saved.unverified;
    let mut lost = Vec::new();
    for saved in saved.rods {
        let at = router
            .rods
            .iter()
            .position(|rod| rod.config.rod == saved.rod && cut_by(&rod.config, settings) == saved.cut_by);
        let assembler = Assembler::resume(&saved.assembler, *settings);
        let (Some(at), Ok(assembler)) = (at, assembler) else {
            if saved.messages > 0 {
                lost.push(format!(
                    "rod {}: its channel or the record settings changed; the open samples of the journal's last part are left out",
                    saved.rod
                ));
            }
            continue;
        };
        router.set_fed_by(at, saved.fed_by);
        router.restore(at, assembler, saved.messages);
    }
    let (moments, grown): (Vec<SavedMoments>, usize) = match rest.is_empty() {
        true => (Vec::new(), 0),
        false => postcard::from_bytes(rest).unwrap_or_else(|_| {
            lost.push("what waited for the records of other sensors comes from another version of the program; it is left out".to_owned());
            (Vec::new(), 0)
        }),
    };
    router.grown = grown;
    for saved in moments {
        let at = router
            .rods
            .iter()
            .position(|rod| rod.config.rod == saved.rod && rod.moments.is_some());
        let at = at.filter(|at| all_cut_by(&router, *at, settings) == saved.cut_by);
        let moments = at.and_then(|at| router.rods.get_mut(at)?.moments.as_mut());
        if moments.is_none_or(|moments| moments.resume(&saved.moments).is_err()) {
            lost.push(format!(
                "rod {}: its sensors or the record settings changed; what waited for the records of other sensors is left out",
                saved.rod
            ));
        }
    }
    (router, lost)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_memory_is_checked_next_as_without_a_restart() {
        let settings = RecordSettings::default();
        let mut router = Router::new(&[], &settings);
        router.grown = 12_345;
        let body = encode(&router, &settings).unwrap();
        let (again, lost) = decode(&body, &[], &settings);
        assert!(again.grown == 12_345 && lost.is_empty(), "{lost:?}");
    }
}
