//! Configuration of rods that tests share.

/// A round rod of iron; its channel has the topic of its name.
pub fn rod(id: &str, length_m: f64, field: &str, fs_hz: f64) -> String {
    format!(
        r#"
[[rod]]
id = "{id}"
length_m = {length_m:?}
section = "round"
[rod.priors]
axial_force_n = {{ mean = 150e3, cv = 0.2 }}
youngs_modulus_pa = {{ mean = 2.0e11, cv = 0.05 }}
density_kg_m3 = {{ mean = 7800, cv = 0.01 }}
diameter_m = {{ mean = 0.04, cv = 0.01 }}
spring_left_n_m = {{ low = 0, high = 100e3 }}
spring_right_n_m = {{ low = 0, high = 100e3 }}
[rod.channel]
topic = "/{id}"
field = "{field}"
unit = "m"
fs_hz = {fs_hz:?}
"#
    )
}

/// The same rod with a thermometer.
pub fn rod_with_air(id: &str, length_m: f64, air: &str) -> String {
    rod(id, length_m, "values", 100.0) + &format!("[rod.temperature]\ntopic = \"{air}\"\nunit = \"degC\"\n")
}

/// Its simulation: `special` is added, in the rod's own table or in one of its own.
pub fn simulated_rod(id: &str, force_n: f64, modes: usize, special: &str) -> String {
    format!(
        r#"
[[simulation.rod]]
id = "{id}"
modes = {modes}
damping = 0.001
ambient_m = 30e-6
[simulation.rod.truth]
axial_force_n = {force_n:?}
youngs_modulus_pa = 2.03e11
density_kg_m3 = 7800
diameter_m = 0.0401
spring_left_n_m = 40e3
spring_right_n_m = 60e3
[simulation.rod.sensor]
at = 0.4
noise_m = 0.5e-6
{special}
"#
    )
}

/// Tie rod between walls: a change of temperature changes its force, two hours late.
pub const RESTRAINED: &str = "[simulation.rod.thermal]\nrestraint = 0.6\nlag_h = 2.0\n";
