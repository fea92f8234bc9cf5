//! `tirante import` as users run it: exit codes, printed lines, and their use by `check` and `replay`.

use crate::program::tirante;
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

fn root(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The shipped recording of the paper's rod as a table with decimal commas.
fn as_table(to: &Path) {
    let bytes = fs::read(root("recordings/todi-pull.mcap")).unwrap();
    let mut table = "Zeit [ns];Weg [m]\n".to_owned();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let body: Value = serde_json::from_slice(&message.data).unwrap();
        let value = format!("{:?}", body["value"].as_f64().unwrap()).replace('.', ",");
        writeln!(table, "{};{value}", message.log_time).unwrap();
    }
    fs::write(to, table).unwrap();
}

const TABLE: &str = "import todi.csv --decimal-comma --channel Weg=/todi/displacement";

/// Fields of a record's line that a file in another format has, too.
const SAME: [&str; 8] = [
    "rod",
    "start",
    "duration_s",
    "fs_hz",
    "modes",
    "axial_force_n",
    "seed",
    "accepted",
];

#[test]
fn an_imported_table_gives_the_same_force_as_the_recording_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    as_table(&at.join("todi.csv"));
    let snippet = tirante(at, &format!("{TABLE} --out todi.mcap")).done();
    assert!(
        snippet.contains("6500 samples at 100 Hz from") && snippet.contains("stamps exactly even"),
        "{snippet}"
    );

    // The printed lines take the place of the configuration's own.
    let config = fs::read_to_string(root("config/todi.toml")).unwrap();
    let (before, rest) = config.split_once("[rod.channel]").unwrap();
    let (_, after) = rest.split_once("[record]").unwrap();
    let (after, _) = after.split_once("[simulation]").unwrap();
    let after = after
        .trim_end()
        .rsplit_once("\n# What `tirante simulate")
        .map_or(after, |(head, _)| head);
    fs::write(
        at.join("todi.toml"),
        format!("{before}{snippet}\n[record]{after}\n"),
    )
    .unwrap();
    tirante(at, "check --quiet todi.toml").done();

    let line = |words: &str| tirante(at, &format!("replay --json {words}")).only();
    let imported = line("todi.mcap --config=todi.toml");
    let shipped = line(&format!(
        "{} --threads=1",
        root("recordings/todi-pull.mcap").display()
    ));
    for field in SAME {
        assert_eq!(imported[field], shipped[field], "{field}");
    }

    // The configuration that reads it is content with it, and one in another unit is not.
    tirante(at, &format!("{TABLE} --config todi.toml --out again.mcap")).done();
    assert_eq!(
        fs::read(at.join("again.mcap")).unwrap(),
        fs::read(at.join("todi.mcap")).unwrap()
    );
    let metres = fs::read_to_string(at.join("todi.toml")).unwrap();
    fs::write(
        at.join("mm.toml"),
        metres.replace("unit = \"m\"", "unit = \"mm\""),
    )
    .unwrap();
    tirante(at, &format!("{TABLE} --config mm.toml --out mm.mcap"))
        .ends(2)
        .says(&["is in m, but the configuration reads"]);
    assert!(!at.join("mm.mcap").exists());
}

#[test]
fn what_is_there_is_not_overwritten_and_what_is_no_file_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("a.csv"), "t,d [mm]\n0,1.5\n0.5,2.5\n").unwrap();
    fs::write(at.join("a.mcap"), "mine").unwrap();
    let import = "import a.csv --start 2026-03-01T06:00:00Z --out a.mcap";
    tirante(at, import).ends(2).says(&["--force"]);
    assert_eq!(fs::read(at.join("a.mcap")).unwrap(), b"mine");
    tirante(at, &format!("{import} --force")).done();
    assert!(fs::read(at.join("a.mcap")).unwrap().starts_with(b"\x89MCAP"));

    tirante(at, "import . --input-format csv")
        .ends(1)
        .says(&["not a regular file"]);
    fs::write(at.join("a.bin"), b"\0\x01").unwrap();
    tirante(at, "import a.bin").ends(2).says(&["--input-format"]);
}

#[test]
fn damage_is_named_with_file_line_and_column_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("a.csv"), "t,d [mm]\n0,1.5\n0.5,2.5\n1.0,broken\n").unwrap();
    let said = tirante(at, "import a.csv --start 2026-03-01T06:00:00Z --out a.mcap").ends(1);
    assert_eq!(
        said.err,
        "error: a.csv: line 4, column 2 (d): \"broken\" is no number; --channel chooses columns\n"
    );
    assert_eq!(fs::read_dir(at).unwrap().count(), 1);
}

#[test]
fn without_out_it_shows_what_is_there_and_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = root("tests/fixtures/import/whole.wav");
    let shown = tirante(&folder, &format!("import {}", path.display())).done();
    assert!(
        shown.contains("32 samples, unit not said (--unit), 2000 Hz, start not said (--start)"),
        "{shown}"
    );
}

/// The samples of the shipped recording \[m\], at 100 Hz, and the time of the first one \[ns\].
fn shipped() -> (Vec<f64>, u64) {
    let bytes = fs::read(root("recordings/todi-pull.mcap")).unwrap();
    let messages: Vec<mcap::Message<'_>> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    let values = messages.iter().map(|message| {
        let body: Value = serde_json::from_slice(&message.data).unwrap();
        body["value"].as_f64().unwrap()
    });
    (values.collect(), messages[0].log_time)
}

fn as_lvm(values: &[f64]) -> Vec<u8> {
    let mut text = "LabVIEW Measurement\t\r\nSeparator\tTab\r\nDecimal_Separator\t,\r\nX_Columns\tNo\r\n***End_of_Header***\t\r\n\t\r\nChannels\t2\t\t\r\nY_Unit_Label\tm\tVolts\t\r\nX_Dimension\tTime\tTime\t\r\nX0\t0,0\t0,0\t\r\nDelta_X\t0,010000\t0,010000\t\r\n***End_of_Header***\t\t\t\r\nX_Value\tlaser\tbridge\tComment\r\n".to_owned();
    for value in values {
        write!(text, "\t{}\t1,5\r\n", format!("{value:?}").replace('.', ",")).unwrap();
    }
    text.into_bytes()
}

fn as_tdms(values: &[f64], first_ns: u64) -> Vec<u8> {
    let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
    let word = |word: u32| word.to_le_bytes().to_vec();
    let fraction = ((u128::from(first_ns % 1_000_000_000) << 64) / 1_000_000_000) as u64 + 1;
    let since_1904 = first_ns / 1_000_000_000 + 2_082_844_800;
    let meta: Vec<u8> = [
        word(1),
        text("/'run'/'laser'"),
        word(20),
        word(10),
        word(1),
        (values.len() as u64).to_le_bytes().to_vec(),
        word(3),
        text("wf_increment"),
        word(10),
        0.01_f64.to_le_bytes().to_vec(),
        text("wf_start_time"),
        word(0x44),
        fraction.to_le_bytes().to_vec(),
        since_1904.to_le_bytes().to_vec(),
        text("unit_string"),
        word(0x20),
        text("m"),
    ]
    .concat();
    let raw: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let sizes = [(meta.len() + raw.len()) as u64, meta.len() as u64];
    [
        b"TDSm\x0e\0\0\0\x69\x12\0\0".to_vec(),
        sizes.iter().flat_map(|size| size.to_le_bytes()).collect(),
        meta,
        raw,
    ]
    .concat()
}

fn as_array(values: &[f64]) -> Vec<u8> {
    let header = format!(
        "{{'descr': '>f8', 'fortran_order': True, 'shape': ({}, 2), }}",
        values.len()
    );
    let mut bytes = b"\x93NUMPY\x01\0".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values.iter().flat_map(|_| 0.25_f64.to_be_bytes()));
    bytes.extend(values.iter().flat_map(|value| value.to_be_bytes()));
    bytes
}

fn as_sound(values: &[f64]) -> Vec<u8> {
    let mut bytes =
        b"RIFF\0\0\0\0WAVEfmt \x10\0\0\0\x03\0\x01\0\x64\0\0\0\x20\x03\0\0\x08\0\x40\0data".to_vec();
    bytes.extend((8 * values.len() as u32).to_le_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

fn as_semicolons(values: &[f64]) -> Vec<u8> {
    let mut text = "# Messung 7\r\nZeit;Weg;Zustand;\r\nms;m;;\r\nLaser;Laser;;\r\n\r\n".to_owned();
    for (index, value) in values.iter().enumerate() {
        let value = format!("{value:?}").replace('.', ",");
        write!(text, "{};{value};ok;\r\n", 10 * index).unwrap();
    }
    text.into_bytes()
}

#[test]
fn every_format_gives_the_force_of_the_recording_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (values, first_ns) = shipped();
    let config = root("config/todi.toml");
    let identify = |file: &str, flags: &str| {
        tirante(
            at,
            &format!("identify --json {file} --config {} {flags}", config.display()),
        )
    };
    let expected = identify(root("recordings/todi-pull.mcap").to_str().unwrap(), "").only();
    // The record begins later, at the onset of its decay.
    let start = tirante::analysis::signal::record::Timestamp::from_nanos(first_ns as i64);
    let start = format!("--start {start}");
    assert!(expected["axial_force_n"]["mean"].as_f64().unwrap() > 0.0);
    for (name, bytes, flags) in [
        ("pull.lvm", as_lvm(&values), start.clone()),
        ("pull.tdms", as_tdms(&values, first_ns), String::new()),
        // Its extension does not match its format.
        ("pull.dat", as_tdms(&values, first_ns), String::new()),
        (
            "pull.npy",
            as_array(&values),
            format!("{start} --rate 100 --channel [:,1]"),
        ),
        ("pull.wav", as_sound(&values), format!("{start} --full-scale 1")),
        ("pull.csv", as_semicolons(&values), start.clone()),
    ] {
        fs::write(at.join(name), bytes).unwrap();
        let found = identify(name, &flags).says(&["/todi/displacement of rod"]).only();
        for field in SAME {
            assert_eq!(found[field], expected[field], "{name}: {field}");
        }
        fs::remove_file(at.join(name)).unwrap();
        let left: Vec<_> = fs::read_dir(at)
            .unwrap()
            .flatten()
            .map(|entry| entry.file_name())
            .collect();
        assert!(
            left.iter().all(|name| !name.to_string_lossy().contains("pull")),
            "{left:?}"
        );
    }
}

#[test]
fn a_file_that_cannot_be_told_says_what_it_holds_and_what_to_add() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::copy(root("config/todi.toml"), at.join("todi.toml")).unwrap();
    let rows = |row: &dyn Fn(usize) -> String| (0..40).map(row).collect::<String>();
    let sine = |index: usize| (index as f64 * 0.7).sin();
    let files = [
        (
            "mm.csv",
            format!(
                "t [s],d [mm]\n{}",
                rows(&|i| format!("{:.2},{}\n", i as f64 / 100.0, sine(i)))
            ),
        ),
        (
            "two.csv",
            format!(
                "t [s],a [m],b [m]\n{}",
                rows(&|i| format!("{:.2},{},{}\n", i as f64 / 100.0, sine(i), -sine(i)))
            ),
        ),
        (
            "none.csv",
            format!(
                "x,d\n{}",
                rows(&|i| format!("{:.2},{}\n", i as f64 / 50.0, sine(i)))
            ),
        ),
        (
            "uneven.csv",
            format!(
                "t,d [m]\n{}",
                rows(&|i| format!("{:.4},{}\n", i as f64 / 100.0 + 0.004 * (i % 2) as f64, sine(i)))
            ),
        ),
        (
            "good.csv",
            format!(
                "t,d [m]\n{}",
                rows(&|i| format!("{:.2},{}\n", i as f64 / 100.0, sine(i)))
            ),
        ),
        ("image.bin", "\u{0}\u{1}\u{2}".to_owned()),
    ];
    for (name, text) in &files {
        fs::write(at.join(name), text).unwrap();
    }
    let said = |line: &str| {
        let said = tirante(at, line).ends(if line.starts_with("import") { 2 } else { 1 });
        assert!(said.out.is_empty());
        said
    };
    for (line, parts) in [
        ("identify mm.csv --config todi.toml", &["is in mm", "in m:"][..]),
        (
            "identify two.csv --config todi.toml",
            &["2 \"a\" (40 samples, m", "3 \"b\"", "--channel"],
        ),
        (
            "identify good.csv",
            &[
                "without --config the rod is not known",
                "tirante measure",
                "2 \"d\" (40 samples, m",
            ],
        ),
        (
            "identify good.csv --channel d",
            &["without --config the rod is not known"],
        ),
        (
            "identify none.csv --config todi.toml --rate 100",
            &["column", "50 Hz", "100 Hz"],
        ),
        (
            "identify none.csv --config todi.toml --rate 100 --channel d",
            &["50 Hz", "100 Hz"],
        ),
        (
            "identify good.csv --config todi.toml --rate 50",
            &["100 Hz by the file, 50 Hz by --rate"],
        ),
        (
            "import uneven.csv --start 2026-03-01T06:00:00Z --out x.mcap",
            &["uneven", "--resample"],
        ),
        ("replay good.csv --config todi.toml", &["--start"]),
        (
            "identify image.bin --config todi.toml",
            &["no format that is read", "TDMS"],
        ),
    ] {
        let said = said(line).says(parts).err;
        assert!(
            !said.contains("copy the file again") && !said.contains("--time none"),
            "{said}"
        );
    }
    let recording = root("recordings/todi-pull.mcap");
    said(&format!("identify {} --rate 100", recording.display()))
        .says(&["is a recording, which says all of itself"]);
}

#[test]
fn replay_takes_files_of_other_programs_in_the_order_of_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (values, first_ns) = shipped();
    // The later one is named first, and sorts first by its name.
    fs::write(at.join("a.tdms"), as_tdms(&values, first_ns + 3_600_000_000_000)).unwrap();
    fs::write(at.join("b.tdms"), as_tdms(&values, first_ns)).unwrap();
    fs::copy(root("config/todi.toml"), at.join("todi.toml")).unwrap();
    let replay = "replay --json a.tdms b.tdms --config todi.toml";
    let starts: Vec<String> = tirante(at, replay)
        .ends(0)
        .lines()
        .iter()
        .map(|line| line["start"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(starts.len(), 2);
    assert!(starts[0] < starts[1], "{starts:?}");
    tirante(at, &format!("{replay} --start 2026-03-01T06:00:00Z"))
        .ends(2)
        .says(&["one by one"]);
}

#[test]
fn a_configuration_is_written_from_a_table() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut table = "t,laser [um]\n".to_owned();
    for index in 0..50 {
        writeln!(
            table,
            "{:.3},{}",
            f64::from(index) / 200.0,
            (f64::from(index) * 0.7).sin()
        )
        .unwrap();
    }
    fs::write(at.join("laser.csv"), table).unwrap();
    tirante(
        at,
        "init laser.csv --out site.toml --length-m 9.5 --diameter-m 0.045 --material steel",
    )
    .done();
    let config = fs::read_to_string(at.join("site.toml")).unwrap();
    for part in ["\"laser\"", "\"um\"", "200.0"] {
        assert!(config.contains(part), "{part}: {config}");
    }
}

/// Two minutes of a rod's motion at 100 Hz, each line as `row` writes it.
fn moving(head: &str, row: impl Fn(usize, f64) -> Option<String>) -> String {
    let (mut seed, mut table) = (1_u64, format!("{head}\n"));
    for index in 0..12_000 {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let noise = (seed >> 40) as f64 / f64::from(1 << 24) - 0.5;
        let value = (index as f64 * 0.3).sin() + (index as f64 * 0.71).sin() + 0.2 * noise;
        if let Some(row) = row(index, value) {
            writeln!(table, "{row}").unwrap();
        }
    }
    table
}

/// `spectrum --format json` of a table: its lines and the messages.
fn spectrum(table: &str, more: &str) -> (Vec<Value>, String) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.csv"), table).unwrap();
    let said = tirante(
        &folder,
        &format!("spectrum a.csv --format json --plot never {more}"),
    );
    (said.lines(), said.err)
}

/// Samples filled in the first record.
fn filled(lines: &[Value]) -> Option<u64> {
    let mut flags = lines.first()?["flags"].as_array()?.iter();
    flags.find(|flag| flag["flag"] == "filled")?["samples"].as_u64()
}

#[test]
fn rows_lost_from_a_table_are_missing_samples_of_its_rate() {
    let table = moving("timestamp,d [mm]", |index, value| {
        let is_lost = index % 97 == 50 || index % 401 == 7;
        (!is_lost).then(|| format!("{:.6},{value}", 1_772_345_000.0 + index as f64 / 100.0))
    });
    let lost = (0..12_000).filter(|i| i % 97 == 50 || i % 401 == 7).count() as u64;
    let (lines, said) = spectrum(&table, "");
    let shown = format!("{lines:?} {said}");
    assert_eq!(lines.len(), 1, "{shown}");
    assert!(
        (lines[0]["fs_hz"].as_f64().unwrap() - 100.0).abs() < 1e-3,
        "{shown}"
    );
    assert_eq!(filled(&lines), Some(lost), "{shown}");
    let (lines, said) = spectrum(&table, "--resample 100");
    let shown = format!("{lines:?} {said}");
    assert_eq!(filled(&lines), Some(lost), "{shown}");
    assert!(
        said.contains("interpolated up to") && said.contains(&format!("{lost} samples missing")),
        "{shown}"
    );
}

#[test]
fn days_of_a_spreadsheet_are_read_and_bad_stamps_left_out() {
    let table = moving("timestamp,d [mm]", |index, value| {
        Some(format!("{:.10},{value}", 46_082.25 + index as f64 / 8_640_000.0))
    });
    for more in [
        "",
        "--time-unit d",
        "--time none --rate 100",
        "--time none --rate 100 --channel 2",
    ] {
        let (lines, said) = spectrum(&table, more);
        let shown = format!("{more} {lines:?} {said}");
        assert_eq!(lines.len(), 1, "{shown}");
        assert!(
            (lines[0]["fs_hz"].as_f64().unwrap() - 100.0).abs() < 1e-3,
            "{shown}"
        );
        assert_eq!(
            shown.contains("2026-03-01T06:00:00"),
            !more.starts_with("--time "),
            "{shown}"
        );
    }
    // Stamps so coarse that they repeat are no motion either.
    let table = moving("time [s],d [mm]", |index, value| {
        Some(format!("{:.1},{value}", (index / 10) as f64 / 10.0))
    });
    let (_, said) = spectrum(&table, "");
    assert!(said.contains("--time none --rate HZ"), "{said}");
    let (lines, said) = spectrum(&table, "--time none --rate 100");
    assert_eq!(lines.len(), 1, "{lines:?} {said}");
    assert!(said.contains("left out: channel 1 (time)"), "{said}");
}
