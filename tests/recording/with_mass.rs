//! Records of one rod with a mass on it and without, in one call of `identify`.

use crate::site::rods::{rod, simulated_rod};
use crate::site::*;

/// Five kilograms on a rod of 78 take 4 % from mode 1, six from mode 2: its labels alone would refuse such a rod.
#[test]
fn records_with_a_mass_and_without_give_one_force() {
    let config = format!(
        "[site]\nname = \"One rod\"\nseed = 5\n[abc]\ndraws = 2000\naccept = {{ quantile = 0.1 }}\n{}",
        rod("a", 8.0, "values", 100.0)
    );
    let site = Site::new(&config);
    let simulated = |name: &str, records: usize, hung: &str| {
        let simulation = format!(
            "{config}\n[simulation]\nstart = 2026-03-01T00:00:00Z\nrecords = {records}\ninterval_s = 600.0\nrecord_s = 60.0\n\
             fs_hz = 100.0\nsamples_per_message = 20\nencoding = \"protobuf\"\n{}",
            simulated_rod("a", 142e3, 3, hung)
        );
        site.simulate_as(name, &simulation, 3);
    };
    let mass = "[simulation.rod.added_mass]\nmass_kg = 5.0\nat = 0.3\n";
    simulated("bare.mcap", 2, "");
    simulated("heavy.mcap", 1, mass);
    simulated("heavier.mcap", 3, mass);
    let sds = |extra: &[&str]| -> Vec<f64> {
        let words = [
            &["identify", "bare.mcap", "--config", "site.toml", "--json"],
            extra,
        ]
        .concat();
        let output = site.run(&words);
        assert!(output.status.success(), "{}", text(&output.stderr));
        let rows = lines(&output.stdout);
        assert_eq!(rows.len(), 2);
        let sd = |row: &serde_json::Value| {
            let force = &row["axial_force_n"];
            let (low, high) = (force["q025"].as_f64().unwrap(), force["q975"].as_f64().unwrap());
            assert!(low < 142e3 && 142e3 < high, "{force}");
            force["sd"].as_f64().unwrap()
        };
        rows.iter().map(sd).collect()
    };
    let alone = sds(&[]);
    for heavy in ["heavy.mcap", "heavier.mcap"] {
        let tested = sds(&["--mass", "5kg@0.3L", "--with-mass", heavy]);
        assert!(
            tested.iter().zip(&alone).all(|(tested, alone)| tested < alone),
            "{tested:?} {alone:?}"
        );
    }
    // The bare record told as the loaded one contradicts the mass.
    let words = [
        "identify",
        "bare.mcap",
        "--config",
        "site.toml",
        "--json",
        "--mass",
        "5kg@0.3L",
        "--with-mass",
        "bare.mcap",
    ];
    let output = site.run(&words);
    assert!(!output.status.success(), "{}", text(&output.stdout));
}
