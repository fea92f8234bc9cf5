//! Fitted emulators on disk, named by the hash of their inputs; a damaged or stale file is refitted.
//!
//! A file is four parts: a line with the format, the key, the SHA-256 of the body, and the body as JSON. It is
//! written next to its place, flushed and renamed, so that a reader sees all of it or nothing. A faulty file
//! gives a warning and a new fit; a faulty directory costs only a fit at the next start.
//!
//! Only the Hermite chaos is kept. The reduced emulator serves every rod and is part of the program, so there is nothing to go
//! stale.

use crate::analysis::rod::beam::forward::ForwardModel;
use crate::analysis::rod::beam::{Exact, FiniteElements, finite_elements};
use crate::analysis::rod::emulator::pce::{self, Fitted};
use crate::analysis::rod::emulator::{FitError, ModelSettings, OrExact, Pce, ReducedModel};
use crate::analysis::rod::prior::RodPrior;
use crate::recording::atomic::AtomicFile;
use crate::site::hex::hex;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// First line of every file.
const FORMAT: &str = "tirante-emulator 1";
/// Longest file that is read \[bytes\].
const LONGEST: u64 = 64 << 20;

/// Forward model by `settings`, for rods with this prior.
///
/// A Hermite chaos comes from the user's cache directory, or is fitted and kept there; outside its trained
/// range the exact model answers ([`OrExact`]).
/// `solved` is called with the number of model solves newly done and the total.
pub fn model(
    settings: &ModelSettings,
    prior: &RodPrior,
    cache: &Cache,
    solved: &(dyn Fn(usize, usize) + Sync),
) -> Result<Arc<dyn ForwardModel>, FitError> {
    let parameterisation = *prior.parameterisation();
    Ok(match *settings {
        ModelSettings::Exact => Arc::new(Exact::new(parameterisation)),
        ModelSettings::FiniteElements { elements } => {
            Arc::new(FiniteElements::new(parameterisation, elements))
        }
        ModelSettings::Reduced => Arc::new(ReducedModel::new(parameterisation)),
        ModelSettings::Pce { order } => Arc::new(OrExact::new(
            cache.pce(prior, order, finite_elements::ELEMENTS, solved)?.0,
        )),
    })
}

/// Origin of a fitted emulator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// Read from this file.
    Read(PathBuf),
    /// Fitted, and kept in this file.
    Kept(PathBuf),
    /// Fitted, and not kept.
    Fitted,
}

/// A directory of fitted emulators.
#[derive(Debug, Clone)]
pub struct Cache {
    directory: Option<PathBuf>,
}

impl Cache {
    /// `TIRANTE_CACHE_DIR`, or `tirante` in `XDG_CACHE_HOME`, or in `.cache` of `HOME`; without any of these
    /// nothing is kept.
    pub fn of_user() -> Self {
        let set = |name: &str| {
            std::env::var_os(name)
                .filter(|value| !value.is_empty())
                .map(PathBuf::from)
        };
        let directory = set("TIRANTE_CACHE_DIR")
            .or_else(|| set("XDG_CACHE_HOME").map(|base| base.join("tirante")))
            .or_else(|| set("HOME").map(|home| home.join(".cache").join("tirante")));
        Self { directory }
    }

    /// Cache in this directory.
    pub fn at(directory: impl Into<PathBuf>) -> Self {
        Self {
            directory: Some(directory.into()),
        }
    }

    /// The Hermite chaos of `order` for this prior, trained on `elements` finite elements: read, or fitted and
    /// kept.
    pub fn pce(
        &self,
        prior: &RodPrior,
        order: usize,
        elements: usize,
        solved: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<(Pce, Origin), FitError> {
        let key = key(prior, order, elements);
        let path = self
            .directory
            .as_ref()
            .map(|directory| directory.join(format!("pce-{key}.emulator")));
        if let Some(path) = &path {
            let restore = |fitted| {
                Pce::restore(prior, order, fitted).ok_or_else(|| "its coefficients do not fit".to_owned())
            };
            match read(path, &key).and_then(|fitted| fitted.map(restore).transpose()) {
                Ok(Some(pce)) => return Ok((pce, Origin::Read(path.clone()))),
                Ok(None) => {}
                Err(reason) => {
                    tracing::warn!(file = %path.display(), reason, "cached emulator not trusted, fitting anew");
                }
            }
        }
        let pce = Pce::fit(prior, order, elements, solved)?;
        Ok(match path {
            Some(path) => match write(&path, &key, pce.fitted()) {
                Ok(()) => (pce, Origin::Kept(path)),
                Err(error) => {
                    tracing::warn!(file = %path.display(), %error, "fitted emulator not kept");
                    (pce, Origin::Fitted)
                }
            },
            None => (pce, Origin::Fitted),
        })
    }
}

/// Hash of everything that a fitted chaos depends on.
fn key(prior: &RodPrior, order: usize, elements: usize) -> String {
    let mut hash = Sha256::new();
    let mut part = |bytes: &[u8]| {
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    };
    part(FORMAT.as_bytes());
    part(b"pce");
    part(&pce::VERSION.to_le_bytes());
    part(&(order as u64).to_le_bytes());
    part(&(elements as u64).to_le_bytes());
    part(prior.parameterisation().section().key().as_bytes());
    for prior in prior.priors() {
        // Debug prints every digit needed to distinguish two numbers.
        part(format!("{prior:?}").as_bytes());
    }
    hex(hash.finalize().as_slice())
}

/// Reads a file; `None` if there is none, and the fault in words of one that cannot be trusted.
fn read(path: &Path, key: &str) -> Result<Option<Fitted>, String> {
    let mut bytes = Vec::new();
    match File::open(path) {
        Ok(file) => {
            let read = file.take(LONGEST + 1).read_to_end(&mut bytes);
            read.map_err(|error| error.to_string())?;
        }
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error.to_string()),
    }
    parse(&bytes, key).map(Some)
}

fn parse(bytes: &[u8], key: &str) -> Result<Fitted, String> {
    let mut parts = bytes.splitn(4, |&byte| byte == b'\n');
    let mut part = || parts.next().ok_or_else(|| "it is cut short".to_owned());
    if part()? != FORMAT.as_bytes() {
        return Err("it has another format".to_owned());
    }
    if part()? != key.as_bytes() {
        return Err("it belongs to other settings".to_owned());
    }
    let (checksum, body) = (part()?, part()?);
    if checksum != hex(Sha256::digest(body).as_slice()).as_bytes() {
        return Err("its checksum is wrong".to_owned());
    }
    serde_json::from_slice(body).map_err(|error| error.to_string())
}

/// Writes a file so that it is whole or absent, even if the power fails.
fn write(path: &Path, key: &str, fitted: &Fitted) -> std::io::Result<()> {
    let body = serde_json::to_vec(fitted)?;
    let checksum = hex(Sha256::digest(&body).as_slice());
    if let Some(directory) = path.parent() {
        std::fs::create_dir_all(directory)?;
    }
    let mut file = AtomicFile::create(path)?;
    file.write_all(format!("{FORMAT}\n{key}\n{checksum}\n").as_bytes())?;
    file.write_all(&body)?;
    file.commit()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::rod::beam::{Parameterisation, Section};
    use crate::analysis::rod::prior::Prior;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Two uncertain quantities: a fit of nine solves.
    fn small(mean: f64) -> RodPrior {
        let fixed = |value| Prior::Fixed { value };
        let priors = vec![
            Prior::TruncatedNormal { mean, sd: 0.1 * mean },
            fixed(4e5),
            fixed(37.0),
            Prior::TruncatedNormal { mean: 4e5, sd: 4e4 },
            fixed(4e5),
            fixed(14.0),
        ];
        RodPrior::new(Parameterisation::new(Section::Direct), priors).unwrap()
    }

    fn get(cache: &Cache, prior: &RodPrior, order: usize) -> (Pce, Origin, usize) {
        let solves = AtomicUsize::new(0);
        let count = |done: usize, _: usize| {
            solves.fetch_add(done, Ordering::Relaxed);
        };
        let (pce, origin) = cache.pce(prior, order, 10, &count).unwrap();
        (pce, origin, solves.into_inner())
    }

    #[test]
    fn a_second_call_reads_the_same_bits_and_other_settings_do_not() {
        let directory = tempfile::tempdir().unwrap();
        let cache = Cache::at(directory.path());
        let (first, origin, solves) = get(&cache, &small(8e5), 2);
        assert!(matches!(origin, Origin::Kept(_)) && solves == 9);
        let (second, origin, solves) = get(&cache, &small(8e5), 2);
        assert!(matches!(origin, Origin::Read(_)) && solves == 0);
        assert_eq!(first.fitted(), second.fitted());
        for (prior, order) in [(small(8.000000000000001e5), 2), (small(8e5), 1)] {
            assert!(matches!(get(&cache, &prior, order).1, Origin::Kept(_)));
        }
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 3);
    }

    #[test]
    fn every_truncation_and_every_flipped_bit_is_found() {
        let directory = tempfile::tempdir().unwrap();
        let cache = Cache::at(directory.path());
        let (first, origin, _) = get(&cache, &small(8e5), 2);
        let Origin::Kept(path) = origin else {
            panic!("{origin:?}")
        };
        let key = key(&small(8e5), 2, 10);
        let whole = std::fs::read(&path).unwrap();
        assert!(parse(&whole, &key).is_ok());
        for length in 0..whole.len() {
            assert!(parse(&whole[..length], &key).is_err(), "{length}");
        }
        let mut flipped = whole.clone();
        for bit in 0..8 * whole.len() {
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(parse(&flipped, &key).is_err(), "{bit}");
            flipped[bit / 8] ^= 1 << (bit % 8);
        }
        let mut longer = whole.clone();
        longer.push(b' ');
        assert!(parse(&longer, &key).is_err());
        for damaged in [&whole[..0], &whole[..40], &whole[..whole.len() - 1], &longer] {
            std::fs::write(&path, damaged).unwrap();
            let (again, origin, solves) = get(&cache, &small(8e5), 2);
            assert!(matches!(origin, Origin::Kept(_)) && solves == 9);
            assert_eq!(again.fitted(), first.fitted());
            assert_eq!(std::fs::read(&path).unwrap(), whole);
        }
    }

    #[test]
    fn a_file_with_the_wrong_number_of_coefficients_is_refitted() {
        let directory = tempfile::tempdir().unwrap();
        let cache = Cache::at(directory.path());
        let (_, origin, _) = get(&cache, &small(8e5), 2);
        let Origin::Kept(path) = origin else {
            panic!("{origin:?}")
        };
        let (other, _, _) = get(&cache, &small(8e5), 3);
        write(&path, &key(&small(8e5), 2, 10), other.fitted()).unwrap();
        assert!(matches!(get(&cache, &small(8e5), 2).1, Origin::Kept(_)));
    }

    #[test]
    fn an_unusable_directory_only_costs_the_fit() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("file");
        std::fs::write(&file, "in the way").unwrap();
        let (_, origin, solves) = get(&Cache::at(&file), &small(8e5), 2);
        assert!(origin == Origin::Fitted && solves == 9);
        let (_, origin, _) = get(&Cache { directory: None }, &small(8e5), 2);
        assert_eq!(origin, Origin::Fitted);
    }

    #[test]
    fn every_setting_gives_the_model_it_names() {
        let cache = Cache { directory: None };
        let prior = small(8e5);
        for (settings, name) in [
            (ModelSettings::Exact, "exact"),
            (ModelSettings::FiniteElements { elements: 50 }, "finite-elements"),
            (ModelSettings::Reduced, "reduced"),
            (ModelSettings::Pce { order: 3 }, "pce"),
        ] {
            let model = model(&settings, &prior, &cache, &|_, _| ()).unwrap();
            assert_eq!(model.name(), name);
            let (mut f, mut closed) = ([0.0; 3], [0.0; 3]);
            // Far out in the prior's tail too.
            for force in [8e5, 1e5] {
                let theta = [force, 4e5, 37.0, 4e5, 4e5, 14.0];
                model.frequencies(&theta, &mut f).unwrap();
                Exact::new(*prior.parameterisation())
                    .frequencies(&theta, &mut closed)
                    .unwrap();
                for (f, closed) in f.iter().zip(closed) {
                    // A chaos of order three inside its range, exact outside.
                    assert!((f / closed - 1.0).abs() < 2e-5, "{name} {f} {closed}");
                }
            }
        }
        assert!(model(&ModelSettings::Pce { order: 0 }, &prior, &cache, &|_, _| ()).is_err());
    }
}
