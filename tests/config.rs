//! The configuration: every fault at once with its place, defaults, round trips, the documentation.

use tirante::bayes::RodPrior;
use tirante::config::{Config, ConfigError, Fault};

fn faults(text: &str) -> Vec<Fault> {
    match Config::parse(text, "test.toml") {
        Err(ConfigError::Faults { faults, .. }) => faults,
        Err(other) => panic!("{other}"),
        Ok(config) => panic!("accepted:\n{}", config.effective()),
    }
}

fn shown(text: &str) -> Vec<String> {
    faults(text).iter().map(Fault::to_string).collect()
}

const MINIMAL: &str = include_str!("../config/minimal.toml");

#[test]
fn the_built_in_rod_is_the_papers() {
    let config = Config::built_in();
    let rod = &config.rods[0].analysis;
    assert_eq!(rod.prior, RodPrior::todi());
    assert_eq!(rod.discrepancy, [0.0; 3]);
}

#[test]
fn the_effective_configuration_reads_back_as_the_same() {
    for text in [MINIMAL, include_str!("../config/todi.toml")] {
        let config = Config::parse(text, "a").unwrap();
        let printed = config.effective();
        let again = Config::parse(&printed, "b").unwrap_or_else(|error| panic!("{error}\n{printed}"));
        assert_eq!(config.hash(), again.hash(), "{printed}");
        assert_eq!(config.rods, again.rods);
        assert_eq!(config.record, again.record);
        println!("{printed}");
    }
}

#[test]
fn every_fault_is_reported_at_once_with_its_place() {
    let text = r#"
[site]
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
    let shown = shown(text);
    println!("{}", shown.join("\n"));
}
