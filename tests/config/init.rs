//! `tirante init`: its configuration for a recording, its errors, and that the configuration can be used
//! unchanged.
use crate::program::{Said, tirante};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use tirante::analysis::identify::Plan;
use tirante::analysis::inference::{Marginal, Tables};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::beam::{Exact, Quantity};
use tirante::analysis::rod::emulator::fallback::OrExact;
use tirante::analysis::rod::emulator::reduced::ReducedModel;
use tirante::analysis::rod::prior::RodPrior;
use tirante::analysis::signal::modes::Mode;
use tirante::analysis::signal::record::Unit;
use tirante::config::Config;
use tirante::recording::read::contents::contents;
use tirante::recording::write::{Encoding, Layout, WriterOptions};

const RECORDING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/campaign-2025.mcap");

const ROD: &str = "--length-m 14 --side-m 0.0715 --material iron --out site.toml";

fn init(folder: &Path, more: &str) -> Said {
    tirante(folder, &format!("init {ROD} {more}"))
}

#[test]
fn a_recording_says_where_its_samples_are() {
    let folder = tempfile::tempdir().unwrap();
    init(folder.path(), RECORDING).done();
    let text = fs::read_to_string(folder.path().join("site.toml")).unwrap();
    let config = Config::parse(&text, "site.toml").unwrap();
    let shipped = Config::load(Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/config/campaign.toml"
    )))
    .unwrap();
    let (written, shipped) = (&config.rods[0].channels, &shipped.rods[0].channels);
    assert_eq!(written.displacement, shipped.displacement);
    assert_eq!(written.temperature, shipped.temperature);
    let checked = tirante(&folder, "check --quiet site.toml").ends(0);
    assert_eq!(checked.err, "");

    init(folder.path(), RECORDING)
        .ends(2)
        .says(&["site.toml: exists"]);
    assert_eq!(fs::read_to_string(folder.path().join("site.toml")).unwrap(), text);
}

/// The paper's record lies beside every beam (f3/f1 = 2.95): with any force from slack to yield it may be modes 2 to 4 of a slack rod
/// too, and both forces are shown. The force expected decides.
#[test]
fn what_is_written_analyses_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let recording = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/todi-pull.mcap");
    for (more, wanted, told) in [("", 3, "1 no-label"), ("--force-n 600e3", 0, "1 identified")] {
        let _ = fs::remove_file(folder.path().join("site.toml"));
        init(folder.path(), &format!("{recording} {more}")).done();
        let line = format!("identify {recording} --config site.toml --draws 20000");
        tirante(&folder, &line).ends(wanted).says(&[told]);
    }
}

#[test]
fn every_encoding_and_layout_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Ros2] {
        for layout in [Layout::Sample, Layout::Batch(50)] {
            fs::write(
                &path,
                crate::common::recording(encoding, layout, WriterOptions::default(), 400),
            )
            .unwrap();
            let found = contents(&path).unwrap();
            assert_eq!(found.len(), 1);
            assert_eq!(
                (found[0].topic.as_str(), found[0].unit),
                ("/laser", Some(Unit::Millimetre))
            );
            assert_eq!(
                found[0].field.as_deref(),
                Ok(crate::common::field(encoding, layout))
            );
            let is_array = matches!(layout, Layout::Batch(_));
            assert_eq!(
                found[0].array_fs_hz,
                is_array.then_some(crate::common::FS),
                "{encoding:?} {layout:?}"
            );
        }
    }
}

#[test]
fn damaged_recordings_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let options = WriterOptions {
        checksums: false,
        chunk_bytes: None,
        ..WriterOptions::default()
    };
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Ros2] {
        let bytes = crate::common::recording(encoding, Layout::Batch(5), options, 40);
        for at in (0..bytes.len()).step_by(5) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << (at % 8);
            fs::write(&path, damaged).unwrap();
            if let Ok(found) = contents(&path) {
                assert!(found.len() <= 2);
            }
        }
    }
}

#[test]
fn what_is_missing_or_impossible_is_named_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    for (more, wanted) in [
        ("--unit mm", "--topic or a recording is needed"),
        ("--topic /a", "--unit is needed"),
        ("--topic /a --unit V", "is no unit"),
        (
            &format!("{RECORDING} --topic /a"),
            "the recording has /nave-3/displacement",
        ),
        (&format!("{RECORDING} --unit mm"), "the recording says m"),
        (&format!("{RECORDING} --id 'no good'"), "is no id"),
        (&format!("{RECORDING} --force-n=-1"), "a positive number"),
        ("nothing.mcap", "nothing.mcap"),
    ] {
        let refused = init(folder.path(), more).says(&[wanted]);
        assert!(matches!(refused.code, Some(1 | 2)), "{refused:?}");
        assert!(!folder.path().join("site.toml").exists(), "{more}");
    }
    tirante(&folder, "init --out site.toml")
        .ends(2)
        .says(&["--length, --section and --material are needed"]);
}

/// Plan of the configuration that `init` writes for a rod of known size and material only: 9.5 m, 50 mm
/// square, iron.
fn unknown_rod(folder: &Path) -> (Plan, RodPrior) {
    let rod = "--length-m 9.5 --side-m 0.05 --material iron";
    tirante(
        folder,
        &format!("init {rod} --topic /rod --unit mm --out unknown.toml"),
    )
    .done();
    let config = Config::load(&folder.join("unknown.toml")).unwrap();
    let settings = config.rods[0].analysis.clone();
    let prior = settings.prior.clone();
    let model = Arc::new(OrExact::new(ReducedModel::new(*prior.parameterisation())));
    (
        Plan::new(settings, model, &Tables::new(config.seed)).unwrap(),
        prior,
    )
}

/// Forces and their 95 % intervals of `rods` rods of the prior's material and size with the given supports in EI / l, at
/// stresses from `stress` \[Pa\] even in the logarithm; frequencies from the exact model with its discrepancy of 1 % and errors of 3 mHz.
fn intervals(
    plan: &Plan,
    prior: &RodPrior,
    rods: u64,
    supports: (f64, f64),
    stress: (f64, f64),
) -> Vec<(f64, Option<Marginal>)> {
    let exact = Exact::new(*prior.parameterisation());
    let modes = plan.settings().modes.count;
    (0..rods)
        .map(|rod| {
            let mut generator = random::stream(supports.1.to_bits() ^ stress.0.to_bits(), rod);
            let mut theta = vec![0.0; 7];
            prior.sample(&mut generator, &mut theta);
            theta[0] = 0.05 * 0.05 * stress.0 * (stress.1 / stress.0).powf(generator.random());
            let bending = 190e9 * 0.05f64.powi(4) / 12.0 / 9.5;
            for spring in &mut theta[4..6] {
                *spring = bending * (supports.0 + (supports.1 - supports.0) * generator.random::<f64>());
            }
            let mut f = vec![0.0; modes];
            exact.frequencies(&theta, &mut f).unwrap();
            let measured = f
                .iter()
                .enumerate()
                .map(|(i, f)| {
                    let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
                    Mode {
                        order: i + 1,
                        frequency_hz: f * (1.0 + 0.01 * normal()) + 0.003 * normal(),
                        sd_hz: 0.003,
                        damping: None,
                    }
                })
                .collect();
            let force = plan.run_frequencies(measured).ok();
            (
                theta[0],
                force.and_then(|identification| identification.posterior.marginal(Quantity::AxialForce)),
            )
        })
        .collect()
}

fn covered(intervals: &[(f64, Option<Marginal>)]) -> usize {
    intervals
        .iter()
        .filter(|(truth, found)| found.is_some_and(|f| f.q025 <= *truth && *truth <= f.q975))
        .count()
}

/// Soft, middling and stiff supports (0 to 6, 2 to 10, 6 to 30 EI / l), each a narrow part of the range that
/// `init` allows: 120 rods each, 114 give or take 2.4 inside. The campaign below has a thousand.
#[test]
fn what_init_writes_covers_soft_and_stiff_supports() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, prior) = unknown_rod(folder.path());
    for supports in [(0.0, 6.0), (2.0, 10.0), (6.0, 30.0)] {
        let found = intervals(&plan, &prior, 120, supports, (5e6, 200e6));
        assert!(found.iter().all(|(_, force)| force.is_some()));
        let inside = covered(&found);
        println!("{supports:?}: {inside} of 120");
        assert!(inside >= 106, "{supports:?}: {inside}");
    }
}

/// Rods of 1.5 to 6 kN and of 6 to 15 MPa are forces like others.
#[test]
fn what_init_writes_holds_for_slack_rods() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, prior) = unknown_rod(folder.path());
    for stress in [(0.6e6, 2.4e6), (6e6, 15e6)] {
        let found = intervals(&plan, &prior, 60, (0.0, 30.0), stress);
        assert!(found.iter().all(|(_, force)| force.is_some()));
        // 57 give or take 1.7.
        assert!(covered(&found) >= 51, "{stress:?}: {}", covered(&found));
    }
}

#[test]
#[ignore = "campaign: 8000 rods, about a minute; run with --ignored --nocapture coverage"]
fn coverage_by_supports() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, prior) = unknown_rod(folder.path());
    for supports in [(0.0, 0.5), (0.0, 6.0), (2.0, 10.0), (6.0, 30.0), (30.0, 300.0)] {
        for stress in [(0.6e6, 5e6), (5e6, 200e6)] {
            let found = intervals(&plan, &prior, 800, supports, stress);
            let refused = found.iter().filter(|(_, force)| force.is_none()).count();
            println!(
                "supports {:>3} to {:>3} EI/l, {:>3.1} to {:>3.0} MPa: {:.1} % covered, {refused} refused",
                supports.0,
                supports.1,
                stress.0 * 1e-6,
                stress.1 * 1e-6,
                100.0 * covered(&found) as f64 / 800.0
            );
        }
    }
}

#[test]
fn what_was_not_asked_is_told_and_the_next_command_can_be_pasted() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::copy(RECORDING, at.join("Navata nord.mcap")).unwrap();
    let rod = "--length 14 --section s71.5 --material iron";
    let Said { out, err, .. } = tirante(
        at,
        &format!("init 'Navata nord.mcap' {rod} --out 'nord uno.toml'"),
    )
    .ends(0);
    assert!(
        out.ends_with("  tirante identify 'Navata nord.mcap' --config 'nord uno.toml'\n"),
        "{out}"
    );
    assert!(err.contains("rod-1") && err.contains("A site"), "{err}");
}
