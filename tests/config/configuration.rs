//! The configuration: every fault at once with its place, defaults, round trips, the documentation.

use proptest::prelude::*;
use std::path::Path;
use tirante::analysis::inference::{Accept, Noise};
use tirante::analysis::lab::synthesis::Truth;
use tirante::analysis::rod::beam::Quantity;
use tirante::analysis::rod::emulator::ModelSettings;
use tirante::analysis::rod::prior::{Prior, RodPrior};
use tirante::analysis::signal::record::{Cut, RecordSettings, RodId, TimeSource, Unit};
use tirante::config::{Config, ConfigError, Fault, KeyReference, LONGEST, Setting};

const MINIMAL: &str = include_str!("../../config/minimal.toml");
const TODI: &str = include_str!("../../config/todi.toml");
const CAMPAIGN: &str = include_str!("../../config/campaign.toml");
const DAEMON: &str = include_str!("../../config/daemon.toml");
const EVERY_KEY: &str = include_str!("every-key.toml");

fn good(text: &str) -> Config {
    Config::parse(text, "good.toml").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn faults(text: &str) -> Vec<Fault> {
    match Config::parse(text, "bad.toml") {
        Err(ConfigError::Faults { faults, .. }) => faults,
        Err(other) => panic!("{other}"),
        Ok(config) => panic!("accepted:\n{}", config.effective()),
    }
}

/// Faults as they are shown, without the place.
fn messages(text: &str) -> Vec<String> {
    faults(text)
        .iter()
        .map(|fault| format!("{}: {}", fault.key, fault.message))
        .collect()
}

#[test]
fn the_built_in_rod_is_the_papers() {
    let config = Config::built_in();
    let rod = &config.rods[0].analysis;
    assert_eq!(rod.prior, RodPrior::todi());
    assert_eq!(rod.discrepancy, [0.0; 3]);
    let simulation = config.simulation.unwrap().simulation;
    assert_eq!(
        simulation.rods[0].truth,
        Truth::Frequencies(vec![4.492, 9.288, 13.252])
    );
}

#[test]
fn a_rod_needs_only_id_length_section_priors_and_a_channel() {
    let config = good(MINIMAL);
    assert_eq!(config.record, RecordSettings::default());
    let rod = &config.rods[0];
    assert_eq!(rod.analysis.abc, Default::default());
    assert_eq!(rod.analysis.welch, Default::default());
    assert_eq!(rod.analysis.peaks, Default::default());
    assert_eq!(rod.analysis.modes, Default::default());
    assert_eq!(rod.analysis.model, Default::default());
    assert_eq!(rod.channels.displacement.unit, Unit::Metre);
    assert_eq!(rod.channels.temperature, None);
    assert!(config.simulation.is_none());
}

#[test]
fn what_is_written_is_what_is_read() {
    let config = good(EVERY_KEY);
    assert_eq!((config.site.as_str(), config.seed), ("Everywhere", 7));
    assert_eq!(config.record.cut, Cut::Window { length_s: 60.0 });
    let rod = &config.rods[0];
    assert_eq!(rod.analysis.seed, 7);
    assert_eq!(rod.analysis.discrepancy, [0.01, 0.02]);
    assert_eq!(rod.analysis.abc.accept, Accept::Epsilon(0.5));
    assert_eq!(rod.analysis.abc.noise, Noise::Fixed(0.0316));
    assert_eq!(rod.analysis.model, ModelSettings::Pce { order: 4 });
    let modes = &rod.analysis.modes;
    assert_eq!((modes.masks[0].high_hz, modes.least_probability), (51.0, 0.97));
    assert_eq!(modes.band_hz, Some([1.0, 24.0]));
    let windows: Vec<(usize, f64)> = modes.windows.iter().map(|w| (w.order, w.high_hz)).collect();
    assert_eq!(windows, [(1, 5.0), (3, 14.5)]);
    // Those of another rod are its own.
    assert!(config.rods[1].analysis.modes.windows.is_empty());
    let prior = |quantity| *rod.analysis.prior.of(quantity).unwrap();
    assert_eq!(
        prior(Quantity::AxialForce),
        Prior::TruncatedNormal {
            mean: 8e5,
            sd: 0.2 * 8e5
        }
    );
    assert_eq!(
        prior(Quantity::YoungsModulus),
        Prior::LogNormal {
            median: 2e11,
            log_sd: 0.1
        }
    );
    assert_eq!(
        prior(Quantity::Density),
        Prior::Uniform {
            low: 7000.0,
            high: 7900.0
        }
    );
    assert_eq!(prior(Quantity::SpringLeft), Prior::Fixed { value: 0.0 });
    assert_eq!(
        prior(Quantity::Length),
        Prior::TruncatedNormal { mean: 14.0, sd: 0.05 }
    );
    let channel = &rod.channels.displacement;
    assert_eq!((channel.unit, channel.fs_hz), (Unit::Micrometre, Some(50.0)));
    assert_eq!(channel.time, TimeSource::Field("start_ns".into()));
    let simulated = &config.simulation.unwrap().simulation.rods;
    let Truth::Beam { theta, .. } = &simulated[0].truth else {
        panic!("a beam")
    };
    assert_eq!(
        theta[..],
        [7e5, 2e11, 7450.0, 0.07, 0.0, 4e5, 14.0],
        "given, else the priors' centres"
    );
    assert_eq!(simulated[1].rod.0, "round");
}

#[test]
fn every_fault_is_reported_at_once_with_its_place() {
    let text = r#"[site]
nmae = "x"
seed = -1
[record]
cut = "windows"
window_s = 5
max_missing = nan
[[rod]]
id = "a b"
length_m = "14"
section = "square"
[rod.priors]
axial_force_n = { mean = 800 , cv = 3.0 }
density_kg_m3 = 7.5
side_m = 70
youngs_modulus_pa = { mean = 2e11 }
spring_left_n_m = { low = 5, high = 1 }
[rod.channel]
topic = ""
unit = "degC"
colour = 1
"#;
    let shown: Vec<String> = faults(text).iter().map(Fault::to_string).collect();
    let expected = [
        "2:1: site.nmae: unknown key, did you mean name?",
        "3:8: site.seed: -1 is out of range, allowed: 0 <= seed <= 9223372036854775807",
        "5:7: record.cut: \"windows\" is not known, allowed: \"auto\", \"file\", \"window\" or \"free-decay\"",
        "6:12: record.window_s: has no effect here, only with cut = \"window\"; remove it",
        "7:15: record.max_missing: nan is not a number, allowed: 0 <= max_missing <= 0.5",
        "9:6: rod[0].id: \"a b\" is no id: 1 to 64 letters, digits, '-', '_' and '.', not starting with '.'",
        "10:12: rod[0].length_m: \"14\" is a string, a number is wanted",
        "12:1: rod[0].priors.spring_right_n_m: is missing: rotational stiffness of the right support, 0 is a hinge \
         [N m/rad], allowed: 0 <= spring_right_n_m <= 1e12; a number or a distribution",
        "13:37: rod[0].priors.axial_force_n.cv: 3.0 is out of range, allowed: 0 < cv <= 1",
        "14:17: rod[0].priors.density_kg_m3: 7.5 is out of range, allowed: 10 <= density_kg_m3 <= 30000",
        "15:10: rod[0].priors.side_m: 70 is out of range, allowed: 1e-6 <= side_m <= 2",
        "16:21: rod[0].priors.youngs_modulus_pa.cv: is missing: coefficient of variation, allowed: 0 < cv <= 1",
        "17:19: rod[0].priors.spring_left_n_m: low = 5 is not below high = 1",
        "19:9: rod[0].channel.topic: is empty",
        "20:8: rod[0].channel.unit: \"degC\" is not known, allowed: \"m\", \"mm\", \"um\", \"nm\", \"m/s\", \"mm/s\", \
         \"um/s\", \"m/s2\" or \"g\"",
        "21:1: rod[0].channel.colour: unknown key, known here: topic, field, unit, time, fs_hz, at, place_error_m, gain_error",
    ];
    assert_eq!(shown, expected);
}

#[test]
fn relations_between_keys_are_checked() {
    let cases = [
        (
            "[http]\nlisten = \"0.0.0.0:7416\"\n",
            "http.listen: other machines reach 0.0.0.0:7416",
        ),
        (
            "[http]\nlisten = \"localhost\"\n",
            "http.listen: \"localhost\" is no address with a port",
        ),
        (
            "[record]\nmin_duration_s = 100\nmax_duration_s = 50\n",
            "record.max_duration_s: 50 s is less than",
        ),
        (
            "[record]\ncut = \"window\"\nwindow_s = 5\n",
            "record.window_s: 5 s lies outside min_duration_s = 10",
        ),
        (
            "[abc]\ndraws = 1000\n",
            "abc.accept: a share of 0.01 of 1000 draws leaves fewer than 50",
        ),
        (
            "[abc]\naccept = { quantile = 0.1, epsilon = 1 }\n",
            "abc.accept: wants either quantile or epsilon",
        ),
        (
            "[modes]\nmasks = [{ low_hz = 2, high_hz = 1 }]\n",
            "modes.masks[0]: low_hz = 2 is not below",
        ),
        (
            "[emulator]\norder = 3\n",
            "emulator.order: has no effect here, only with model = \"pce\"",
        ),
        (
            "[simulation]\nrecords = 2\ninterval_s = 30\n",
            "simulation.interval_s: 30 s is shorter than a record",
        ),
        (
            "[simulation]\nsamples_per_message = 10\n",
            "simulation.rod: \"rod-1\": arrays are written: its channel must",
        ),
        (
            "[simulation]\nencoding = \"ros2\"\n",
            "simulation.rod: \"rod-1\": encoding and samples_per_message write field \"data\"",
        ),
        (
            "[simulation]\n[[simulation.rod]]\nid = \"x\"\n",
            "simulation.rod[0].id: no [[rod]] is called \"x\"",
        ),
        (
            "[simulation]\n[[simulation.rod]]\nid = \"rod-1\"\nfrequencies_hz = [2, 1]\n",
            "simulation.rod[0].frequencies_hz: is not in ascending order",
        ),
        (
            "[simulation]\n[[simulation.rod]]\nid = \"rod-1\"\nfrequencies_hz = [2]\n[simulation.rod.truth]\n",
            "simulation.rod[0].truth: has no effect beside frequencies_hz",
        ),
        (
            "[simulation]\n[[simulation.rod]]\nid = \"rod-1\"\n[simulation.rod.thermal]\n",
            "simulation.rod[0].thermal: has no effect without [simulation.climate]",
        ),
        (
            "[simulation]\nfs_hz = 1e5\nrecord_s = 3600\n",
            "simulation.record_s: 3600 s at 100000 Hz are more than",
        ),
    ];
    for (section, expected) in cases {
        let found = messages(&format!("{MINIMAL}\n{section}"));
        assert!(
            found.len() <= 2 && found[0].starts_with(expected),
            "{found:?}\nexpected {expected}"
        );
    }
}

#[test]
fn a_chaos_that_cannot_be_fitted_is_refused() {
    let found = messages(&format!("{TODI}\n[emulator]\nmodel = \"pce\"\norder = 12\n"));
    assert!(
        found.len() == 1 && found[0].contains("needs 4826809 model solves for the 6 uncertain"),
        "{found:?}"
    );
    let mut known = MINIMAL.replace("{ low = 0, high = 500e3 }", "0");
    known = known
        .replace("{ mean = 150e3, cv = 0.3 }", "150e3")
        .replace("{ mean = 190e9, cv = 0.1 }", "190e9");
    known = known.replace("{ mean = 7600, cv = 0.03 }", "7600");
    good(&known);
    let found = messages(&format!("{known}\n[emulator]\nmodel = \"pce\"\n"));
    assert!(
        found.len() == 1 && found[0].contains("rod rod-1 has none"),
        "{found:?}"
    );
}

#[test]
fn duplicates_are_refused() {
    let twice = format!("{MINIMAL}\n{MINIMAL}");
    let found = messages(&twice);
    assert!(
        found
            .iter()
            .any(|m| m.contains("is the id of the rod in line 4 too")),
        "{found:?}"
    );
    assert!(
        found
            .iter()
            .any(|m| m.contains("is a channel of the rod in line 4 too")),
        "{found:?}"
    );
    let found = messages(
        &MINIMAL
            .replace("diameter_m", "length_m = 3\ndiameter_m")
            .replace("[rod.priors]", "[rod.priors]\ndiameter_m = 0.05"),
    );
    assert!(found.iter().any(|m| m.contains("duplicate key")), "{found:?}");
    let topic = MINIMAL.lines().find(|line| line.starts_with("topic")).unwrap();
    let found = messages(&format!("{MINIMAL}\n[rod.temperature]\n{topic}\n"));
    assert!(
        found.len() == 1 && found[0].contains("which is the motion of the rod in line 4"),
        "{found:?}"
    );
}

#[test]
fn no_rod_no_text_no_table() {
    assert!(messages("")[0].contains("the configuration is empty"));
    assert!(messages("# only a comment\n")[0].contains("the configuration is empty"));
    assert!(messages("[site]\n")[0].starts_with("rod: is missing: at least one [[rod]]"));
    assert!(messages("[rod]\nid = \"a\"\n")[0].contains("write [[rod]], not [rod]"));
    assert!(messages("rod = 5\n")[0].contains("5 is an integer"));
    assert!(
        messages("record = 5\n")
            .iter()
            .any(|m| m == "record: 5 is an integer, a table is wanted")
    );
}

#[test]
fn faults_of_the_text_and_of_its_meaning_are_reported_together() {
    let text = MINIMAL
        .replace("[site]", "")
        .replace("length_m = 12.5 ", "length_m = 12,5 ")
        + "\n[record]\ncut = \"files\"\nwindow_s 5\n";
    let found = faults(&text);
    assert!(found.iter().any(|f| f.line == 5 && f.key.is_empty()), "{found:?}");
    assert!(found.iter().any(|f| f.key == "record.cut"), "{found:?}");
    assert!(
        found.iter().all(|f| !f.message.contains("missing")),
        "a broken text may hold it: {found:?}"
    );
}

#[test]
fn files_that_are_no_configuration_are_refused_with_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |path: &Path| {
        let error = Config::load(path).unwrap_err().to_string();
        assert!(
            !error.contains('\n') && error.contains(&path.display().to_string()),
            "{error}"
        );
        error
    };
    let write = |bytes: &[u8]| {
        let path = folder.path().join("c.toml");
        std::fs::write(&path, bytes).unwrap();
        path
    };
    assert!(refused(&folder.path().join("none.toml")).contains("No such file"));
    assert!(refused(folder.path()).contains("is no regular file"));
    assert!(refused(Path::new("/dev/zero")).contains("is no regular file"));
    assert!(
        refused(&write(b"[site]\nname = \"\xff\"\n")).contains("is not UTF-8 text, first bad byte in line 2")
    );
    assert!(refused(&write(&vec![b'#'; LONGEST + 1])).contains("is longer than"));
    assert!(refused(&write(b"")).contains("is empty"));
}

#[test]
fn a_huge_text_of_faults_is_answered() {
    let many_keys: String = (0..60_000).map(|i| format!("key{i} = {i}\n")).collect();
    let nested = "[".repeat(100_000);
    let one_line = format!("a = {}", "{ b = ".repeat(100_000));
    let many_rods = "[[rod]]\n".repeat(100_000);
    for text in [many_keys, nested, one_line, many_rods] {
        let found = faults(&text);
        assert!(!found.is_empty() && found.len() <= 501, "{}", found.len());
    }
}

/// For every key there is: values of a wrong type or size are refused at that key's line.
#[test]
fn bad_values_of_every_key_are_named_with_key_and_line() {
    let printed = good(EVERY_KEY).effective();
    let lines: Vec<&str> = printed.lines().collect();
    let mut tried = 0;
    for (number, line) in lines.iter().enumerate() {
        let Some((key, value)) = line.split_once(" = ").filter(|_| !line.starts_with('#')) else {
            continue;
        };
        let is_boolean = value.starts_with("true") || value.starts_with("false");
        for bad in [
            "nan",
            "inf",
            "{}",
            "\"\"",
            "\"\\u0007\"",
            "-1e300",
            if is_boolean { "1" } else { "true" },
            "07:32:00",
            "[[]]",
            "{ a = 1 }",
        ] {
            let mut broken = lines.clone();
            let replaced = format!("{key} = {bad}");
            broken[number] = &replaced;
            let found = faults(&broken.join("\n"));
            let named = found
                .iter()
                .any(|f| f.line == number + 1 && f.key.split(['.', '[']).any(|part| part == key));
            assert!(named, "{replaced} in line {}: {found:?}", number + 1);
            tried += 1;
        }
        // Removed, it is either not needed or named.
        let removed = [&lines[..number], &lines[number + 1..]].concat().join("\n");
        if let Err(ConfigError::Faults { faults, .. }) = Config::parse(&removed, "removed") {
            assert!(
                faults
                    .iter()
                    .any(|f| f.key.ends_with(key) || f.message.contains(key))
                    || key == "id",
                "{key}: {faults:?}"
            );
        }
        // Misspelt, it is unknown.
        let mut misspelt = lines.clone();
        let replaced = line.replacen(key, &format!("{key}x"), 1);
        misspelt[number] = &replaced;
        let found = messages(&misspelt.join("\n"));
        assert!(
            found.iter().any(|m| m.contains("unknown key")),
            "{replaced}: {found:?}"
        );
    }
    assert!(tried > 1000, "{tried}");
}

#[test]
fn the_http_server_listens_on_loopback_unless_somebody_says_otherwise() {
    let listen = |text: &str| good(&format!("{MINIMAL}\n[http]\n{text}\n")).http.listen;
    assert_eq!(listen(""), Some("127.0.0.1:7416".parse().unwrap()));
    assert_eq!(listen("listen = \"off\""), None);
    assert_eq!(
        listen("listen = \"127.0.0.9:0\""),
        Some("127.0.0.9:0".parse().unwrap())
    );
    let mapped = "[::ffff:127.0.0.1]:80";
    assert_eq!(
        listen(&format!("listen = \"{mapped}\"")),
        Some(mapped.parse().unwrap())
    );
    assert_eq!(
        listen("listen = \"192.0.2.1:80\"\nallow_remote = true"),
        Some("192.0.2.1:80".parse().unwrap())
    );
    let text = |remote| format!("{MINIMAL}\n[http]\nallow_remote = {remote}\n");
    assert_eq!(good(&text("true")).hash(), good(&text("false")).hash());
}

#[test]
fn a_rods_meaning_changes_with_what_its_numbers_depend_on_and_nothing_else() {
    let rod = RodId("nave-3".into());
    let meaning = |text: &str| good(text).meaning_of(&rod);
    let same = meaning(CAMPAIGN);
    assert_ne!(same, [0; 32]);
    let named = CAMPAIGN.replace("Simulated campaign", "Another name");
    assert_eq!(
        same,
        meaning(&format!(
            "{named}\n[alarm]\nlimit_loss = 0.2\n[store]\npath = \"a.sqlite\"\n"
        ))
    );
    for (from, to) in [
        ("seed = 20250301", "seed = 20250302"),
        ("mean = 800e3, cv = 0.20", "mean = 810e3, cv = 0.20"),
        ("unit = \"m\"", "unit = \"mm\""),
        ("unit = \"m\"", "unit = \"m\"\ntime = \"publish\""),
        (
            "[simulation]\n",
            "[track]\nbaseline_records = 31\n\n[simulation]\n",
        ),
        ("[simulation]\n", "[modes]\ncount = 4\n\n[simulation]\n"),
    ] {
        assert!(CAMPAIGN.contains(from), "{from}");
        assert_ne!(same, meaning(&CAMPAIGN.replacen(from, to, 1)), "{to}");
    }
    // Without stamps, or with few, the declared rate is that of the record. What is simulated has it, too.
    let (measured, _) = CAMPAIGN.split_once("[simulation]").unwrap();
    assert_eq!(same, meaning(measured));
    for to in ["fs_hz = 40.5", ""] {
        assert_ne!(same, meaning(&measured.replacen("fs_hz = 40.0", to, 1)), "{to}");
    }
    // What is said anyway, where samples lie, and which readings of a thermometer are near a record.
    for (from, to) in [
        ("unit = \"m\"", "unit = \"m\"\ntime = \"log\""),
        ("field = \"values\"", "field = \"point.z\""),
        ("topic = \"/nave-3/displacement\"", "topic = \"/other\""),
    ] {
        assert!(measured.contains(from), "{from}");
        assert_eq!(same, meaning(&measured.replacen(from, to, 1)), "{to}");
    }
    let celsius = "unit = \"degC\"";
    assert!(measured.contains(celsius));
    let to = format!("{celsius}\nfs_hz = 1.0\ntime = \"publish\"");
    assert_eq!(same, meaning(&measured.replace(celsius, &to)));
}

#[test]
fn the_effective_configuration_reads_back_as_the_same() {
    for text in [MINIMAL, TODI, CAMPAIGN, DAEMON, EVERY_KEY] {
        let config = good(text);
        let again = good(&config.effective());
        assert_eq!(config, again);
        assert_eq!(config.hash(), again.hash());
        assert_ne!(
            config.hash(),
            good(&text.replace("14", "13").replace("12.5", "12.6")).hash()
        );
    }
}

#[test]
fn the_daemons_example_follows_the_rod_of_the_campaign() {
    let (daemon, campaign) = (good(DAEMON), good(CAMPAIGN));
    let rod = RodId("nave-3".into());
    assert_eq!(daemon.meaning_of(&rod), campaign.meaning_of(&rod));
    assert_eq!(daemon.rods, campaign.rods);
    assert!(daemon.store.path.is_some() && daemon.ingest.folder.is_some());
    assert!(!daemon.ingest.listen.is_empty());
}

#[test]
fn every_bad_socket_is_named() {
    let text = format!(
        "{MINIMAL}\n[ingest]\nlisten = [\"udp://x\", \"tcp://127.0.0.1:99999\", 7, \"unix:///a\", \"unix:///a\"]\n"
    );
    let found = messages(&text);
    for index in [0, 1, 2, 4] {
        let name = format!("ingest.listen[{index}]");
        assert!(
            found.iter().any(|fault| fault.contains(&name)),
            "{name}: {found:?}"
        );
    }
}

#[test]
fn the_hash_is_that_of_the_meaning_for_measured_data() {
    let config = good(TODI);
    let same = good(
        &TODI
            .replace("800e3", "8.0e5")
            .replace("# known", "# measured")
            .replace("1e-6", "2e-6"),
    );
    assert_eq!(
        config.hash(),
        same.hash(),
        "spelling, comments and the simulation do not matter"
    );
    assert_ne!(config, same);
    assert_ne!(config.hash(), good(&TODI.replace("7500", "7501")).hash());
}

#[test]
fn settings_of_the_command_line_stand_over_the_file() {
    let settings = |texts: &[&str]| {
        texts
            .iter()
            .map(|text| text.parse().unwrap())
            .collect::<Vec<Setting>>()
    };
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/minimal.toml");
    let set = settings(&[
        "abc.draws=5000",
        "abc.accept={ quantile = 0.05 }",
        "record.cut=window",
        "site.seed=9",
    ]);
    // A file of a hundred rods is longer than any width that a format takes.
    let folder = tempfile::tempdir().unwrap();
    let long = folder.path().join("long.toml");
    std::fs::write(&long, format!("{}{MINIMAL}", "# remark\n".repeat(10_000))).unwrap();
    assert_eq!(Config::resolve(Some(&long), &set).unwrap().seed, 9);
    let config = Config::resolve(Some(&file), &set).unwrap();
    let abc = config.rods[0].analysis.abc;
    assert_eq!((abc.draws, abc.accept), (5000, Accept::Quantile(0.05)));
    assert_eq!(config.record.cut, Cut::Window { length_s: 60.0 });
    assert_eq!((config.seed, config.rods[0].analysis.seed), (9, 9));
    assert_ne!(
        config.hash(),
        good(MINIMAL).hash(),
        "what is computed with is what is hashed"
    );
    assert_eq!(config, good(&config.effective()));
    let todi = Config::resolve(None, &settings(&["record.cut=file"])).unwrap();
    assert_eq!(todi.record.cut, Cut::File, "over the file's own");

    let error = Config::resolve(
        Some(&file),
        &settings(&["abc.draws=5", "abc.drams=5", "rod=1", "abc.noise=["]),
    )
    .unwrap_err();
    let shown = error.to_string();
    assert!(
        shown.contains("command line: abc.draws: 5 is out of range, allowed: 1000 <= draws"),
        "{shown}"
    );
    assert!(
        shown.contains("command line: abc.drams: unknown key, did you mean draws?"),
        "{shown}"
    );
    assert!(shown.contains("command line: rod: 1 is an integer"), "{shown}");
    assert!(shown.contains("command line: no TOML"), "{shown}");
}

/// A number as a person might type it.
fn number(low: f64, high: f64) -> impl Strategy<Value = String> {
    (low..high, 0..3).prop_map(|(x, style)| match style {
        0 => format!("{x:e}"),
        1 => format!("{x:?}").replace("e-", "E-"),
        _ => format!("{x:.40}"),
    })
}

fn prior(low: f64, high: f64) -> impl Strategy<Value = String> {
    let middle = 0.5 * (low + high);
    prop_oneof![
        number(low, high),
        (number(low, high), number(0.01, 1.0))
            .prop_map(|(mean, cv)| format!("{{ mean = {mean}, cv = {cv} }}")),
        (number(middle, high), number(low, middle))
            .prop_map(|(mean, sd)| format!("{{ mean = {mean}, sd = {sd} }}")),
        (number(low, high), number(0.01, 2.0)).prop_map(|(m, s)| format!("{{ median = {m}, log_sd = {s} }}")),
        (number(low, middle * 0.99), number(middle, high))
            .prop_map(|(l, h)| format!("{{ low = {l}, high = {h} }}")),
    ]
}

fn configuration() -> impl Strategy<Value = String> {
    let rod = (
        // A chaos needs a quantity to expand.
        prior(1e3, 1e6).prop_filter("an uncertain force", |law| law.starts_with('{')),
        prior(1e10, 3e11),
        prior(7000.0, 8000.0),
        prior(0.01, 0.1),
        prior(1.0, 1e6),
        prior(3.0, 30.0),
    );
    let record = prop_oneof![
        Just(String::new()),
        number(10.0, 100.0).prop_map(|s| format!("cut = \"window\"\nwindow_s = {s}\n")),
        (number(2.0, 9.0), number(10.0, 100.0))
            .prop_map(|(r, s)| format!("cut = \"free-decay\"\nonset_ratio = {r}\ndecay_s = {s}\n")),
    ];
    let accept = prop_oneof![
        number(0.01, 1.0).prop_map(|q| format!("accept = {{ quantile = {q} }}\n")),
        number(0.01, 1.0).prop_map(|e| format!("accept = {{ epsilon = {e} }}\n")),
    ];
    let model = prop_oneof![
        Just("[emulator]\nmodel = \"exact\"\n".to_owned()),
        (8..1000).prop_map(|n| format!("[emulator]\nmodel = \"finite-elements\"\nelements = {n}\n")),
        (1..9).prop_map(|n| format!("[emulator]\nmodel = \"pce\"\norder = {n}\n")),
    ];
    let simulation = prop_oneof![
        Just(String::new()),
        (number(10.0, 100.0), number(1e-6, 1e-3), number(-0.5, 0.5)).prop_map(|(fs, noise, change)| format!(
            "[simulation]\nfs_hz = {fs}\n[[simulation.rod]]\nid = \"r\"\n[simulation.rod.sensor]\nnoise_m = {noise}\n\
             [[simulation.rod.change]]\nrelative = {change}\n"
        )),
    ];
    (rod, record, accept, model, simulation, number(0.0, 0.5), 0..u32::MAX).prop_map(
        |((n, e, rho, d, k, l), record, accept, model, simulation, discrepancy, seed)| {
            format!(
                "[site]\nseed = {seed}\n[record]\n{record}[abc]\n{accept}{model}[[rod]]\nid = \"r\"\nlength_m = {l}\n\
                 section = \"round\"\ndiscrepancy = {discrepancy}\n[rod.channel]\ntopic = \"/\\\"ü\\\\\"\n[rod.priors]\n\
                 axial_force_n = {n}\nyoungs_modulus_pa = {e}\ndensity_kg_m3 = {rho}\ndiameter_m = {d}\n\
                 spring_left_n_m = {k}\nspring_right_n_m = 0\n{simulation}"
            )
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_configuration_reads_back_as_the_same(text in configuration()) {
        let config = good(&text);
        let again = good(&config.effective());
        prop_assert_eq!(&config, &again);
        prop_assert_eq!(config.hash(), again.hash());
    }

    /// A text damaged anywhere is accepted or refused with a place inside it; nothing panics.
    #[test]
    fn damaged_texts_are_answered(at in 0usize..4000, cut in 0usize..60, put in "[\\x00-\\x7f]{0,12}|[\\[\\]{}=.,\"'#\n]{0,6}|é") {
        let mut characters: Vec<char> = EVERY_KEY.chars().collect();
        let at = at.min(characters.len());
        let end = (at + cut).min(characters.len());
        characters.splice(at..end, put.chars());
        let text: String = characters.into_iter().collect();
        if let Err(ConfigError::Faults { faults, .. }) = Config::parse(&text, "damaged") {
            prop_assert!(!faults.is_empty());
            let lines = text.split('\n').count();
            prop_assert!(faults.iter().all(|f| (1..=lines).contains(&f.line) && f.column >= 1 && !f.message.is_empty()));
        }
    }
}

/// The rows of the documentation: `| key | default | allowed | meaning |` under each section's name.
fn documented() -> String {
    let mut keys: Vec<KeyReference> = Vec::new();
    for key in good(EVERY_KEY).reference() {
        if !keys
            .iter()
            .any(|known| known.section == key.section && known.key == key.key)
        {
            keys.push(key);
        }
    }
    let mut sections: Vec<&str> = Vec::new();
    for key in &keys {
        if !sections.contains(&key.section.as_str()) {
            sections.push(&key.section);
        }
    }
    let mut text = String::new();
    for section in sections {
        text += &format!("\n### `{section}`\n\n| key | default | allowed | meaning |\n|---|---|---|---|\n");
        for key in keys.iter().filter(|key| key.section == section) {
            let condition = key
                .condition
                .map_or(String::new(), |words| format!(" Only with {words}."));
            text += &format!(
                "| `{}` | {} | {} | {}.{condition} |\n",
                key.key, key.default, key.allowed, key.meaning
            );
        }
    }
    text
}

#[test]
fn the_documentation_lists_every_key_and_no_other() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/configuration.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let (begin, end) = (
        "<!-- keys: written by UPDATE_DOCS=1 cargo test --test config configuration:: -->\n",
        "<!-- end of keys -->\n",
    );
    let (before, rest) = page.split_once(begin).expect("the mark before the keys");
    let (keys, after) = rest.split_once(end).expect("the mark behind the keys");
    let wanted = format!("{}\n", documented());
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, format!("{before}{begin}{wanted}{end}{after}")).unwrap();
    } else {
        assert_eq!(
            keys, wanted,
            "UPDATE_DOCS=1 cargo test --test config brings the page up to date"
        );
    }
}

#[test]
fn a_bucket_is_a_server_a_bucket_and_the_begin_of_names() {
    let with = |to: &str| format!("{MINIMAL}\n[bucket]\nto = \"{to}\"\ncredentials = \"keys\"\n");
    for (to, parts) in [
        (
            "https://s3.example.org/monuments",
            ["https://s3.example.org", "monuments", ""],
        ),
        (
            "https://s3.example.org:9000/my.bucket-1/umbria/todi/",
            ["https://s3.example.org:9000", "my.bucket-1", "umbria/todi"],
        ),
        ("http://127.0.0.1:9000/own", ["http://127.0.0.1:9000", "own", ""]),
        ("http://[::1]:9000/own", ["http://[::1]:9000", "own", ""]),
    ] {
        let bucket = good(&with(to)).bucket.unwrap();
        assert_eq!([bucket.server.as_str(), &bucket.bucket, &bucket.prefix], parts);
        assert_eq!(bucket.region, "us-east-1");
    }
    for (to, said) in [
        ("s3.example.org/monuments", "is no address"),
        ("ftp://s3.example.org/monuments", "is no address"),
        (
            "https://user:secret@s3.example.org/monuments",
            "keys go into the file",
        ),
        ("https://s3.example.org/monuments?acl", "keys go into the file"),
        ("https://s3.example.org", "names no bucket"),
        ("https://s3.example.org/Monuments", "names no bucket"),
        ("https:///monuments", "names no bucket"),
        ("https://s3.example.org/monuments/../other", "other signs"),
        ("https://s3.example.org/monuments/to di", "other signs"),
        ("http://s3.example.org/monuments", "another machine"),
        ("http://127.0.0.1.example.org/monuments", "another machine"),
    ] {
        let found = messages(&with(to));
        assert!(
            found.len() == 1 && found[0].starts_with("bucket.to: ") && found[0].contains(said),
            "{to}: {found:?}"
        );
    }
    let found = messages(&format!(
        "{MINIMAL}\n[bucket]\nto = \"https://s3.example.org/monuments\"\nregion = \"a b\"\n"
    ));
    assert!(
        found.len() == 2
            && found.iter().any(|said| said.contains("is no region"))
            && found.iter().any(|said| said.contains("access key")),
        "{found:?}"
    );
}

#[test]
fn a_key_without_effect_names_what_would_give_it_one() {
    for key in ["at = 0.3", "gain_error = 0.02", "place_error_m = 0.05"] {
        let channel = "[rod.channel]\n";
        assert!(CAMPAIGN.contains(channel));
        let found = messages(&CAMPAIGN.replacen(channel, &format!("{channel}{key}\n"), 1));
        let (name, _) = key.split_once(' ').unwrap();
        assert!(
            found.len() == 1 && found[0].contains(name) && found[0].contains("only with [[rod.sensor]]"),
            "{key}: {found:?}"
        );
    }
    let test = "[[rod.test]]\nfrequencies_hz = [4.5, 9.3]\nsd_hz = 0.01\nloaded_sd_hz = 0.01\n";
    let found = messages(&format!("{CAMPAIGN}\n{test}"));
    assert!(
        found
            .iter()
            .any(|said| said.contains("loaded_sd_hz") && said.contains("only with loaded_frequencies_hz")),
        "{found:?}"
    );
}

#[test]
fn silence_is_longer_than_the_wait_for_a_sensor() {
    let with = |sensor: &str, silence_h: f64| {
        format!("{MINIMAL}\n{sensor}[track]\nreorder_window_h = 2.0\n[alarm]\nsilence_h = {silence_h:?}\n")
    };
    let second = "at = 0.4\n[[rod.sensor]]\ntopic = \"/rod-1/second\"\nat = 0.1\n";
    let found = messages(&with(second, 2.0));
    assert!(
        found.len() == 1
            && found[0].contains("silence_h = 2 is not longer than the 2 h")
            && found[0].contains("rod-1"),
        "{found:?}"
    );
    good(&with(second, 2.1));
    // Of one sensor nothing is waited for.
    good(&with("", 2.0));
}
