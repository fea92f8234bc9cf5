//! The commented configuration of one rod, as `init` and `measure` write it.

use super::quantities::Expected;
use super::rod_flags::Rod;
use super::sensor::Sensor;
use crate::analysis::signal::record::Unit;
use crate::recording::read::contents::Content;
use std::fmt::Write as _;
use std::io::{self, Write};
use std::path::Path;

/// Least stress assumed without an expected force \[Pa\]: a rod slacker than this hangs like a chain.
const SLACK_PA: f64 = 1e6;
/// Least force assumed of a rod of any section \[N\].
const SLACK_N: f64 = 1e3;

/// Names and facts of one rod.
pub struct Template<'a> {
    /// Command that writes the configuration.
    pub command: &'a str,
    /// Name of the site.
    pub site: &'a str,
    /// Id of the rod.
    pub id: &'a str,
    /// Geometry, material and expected force.
    pub rod: &'a Rod,
    /// Channel of its samples.
    pub sensor: &'a Sensor,
    /// Temperature channel beside them, if any.
    pub thermometer: Option<&'a Content>,
}

impl Template<'_> {
    /// Text of the configuration: the minimum needed, with comments and weak priors.
    pub fn text(&self) -> String {
        let Self {
            command,
            site,
            id,
            rod,
            sensor,
            thermometer,
        } = self;
        let quoted = |text: &str| toml::Value::String(text.to_owned()).to_string();
        let [(modulus, modulus_cv), (density, density_cv)] = rod.material.priors();
        let area_m2 = rod.profile.area_m2();
        let force = match rod.expected {
            Some(Expected::About(force_n)) => {
                format!(
                    "{{ mean = {force_n:?}, cv = 0.3 }}   # as expected; at best from an earlier measurement"
                )
            }
            // The ends are the 2.5 and 97.5 % quantiles, and soft: a record may give a value outside.
            Some(Expected::Between(low, high)) => format!(
                "{{ median = {:.4e}, log_sd = {:.4} }}   # {}",
                (low * high).sqrt(),
                Expected::log_sd(low, high),
                Expected::Between(low, high).said()
            ),
            None => {
                let high_pa = rod.material.yield_pa(area_m2);
                format!(
                    "{{ low = {:.3e}, high = {:.3e}, even_in = \"logarithm\" }}   # nothing is known: from slack to {:.0} MPa",
                    SLACK_N.min(SLACK_PA * area_m2),
                    high_pa * area_m2,
                    high_pa * 1e-6
                )
            }
        };
        let mut text = format!(
            "# Written by `tirante {command}`. `tirante check FILE` prints what holds besides; docs/configuration.md has every key.\n\n\
         [site]\nname = {}\n\n\
         [[rod]]\nid = {}\n\
         length_m = {:?}                # free length between the walls\n\
         section = \"{}\"\n\n\
         [rod.priors]                   # what is known beforehand: a number, or a distribution. Correct them: they count\n\
         axial_force_n = {force}\n\
         youngs_modulus_pa = {{ mean = {modulus:e}, cv = {modulus_cv} }}\n\
         density_kg_m3 = {{ mean = {density}, cv = {density_cv} }}\n",
            quoted(site),
            quoted(id),
            rod.length_m,
            rod.profile.key(),
        );
        // Writing to a string cannot fail.
        for (key, value) in rod.profile.dimensions() {
            let _ = writeln!(
                text,
                "{key} = {{ mean = {value:?}, cv = 0.02 }}   # as measured; rust and hammering included"
            );
        }
        let _ = write!(
            text,
            "spring_left_n_m = {{ fixity_low = 0, fixity_high = 0.99, ends = 2 }}    # supports, from hinged to as good as clamped\n\
         spring_right_n_m = {{ fixity_low = 0, fixity_high = 0.99, ends = 2 }}\n\n\
         [rod.channel]                  # where its samples stand in the recordings\n\
         topic = {}\nfield = {}\nunit = \"{}\"\n",
            quoted(&sensor.topic),
            quoted(&sensor.field),
            sensor.unit.key()
        );
        if let Some(stamp) = &sensor.stamp {
            let _ = writeln!(
                text,
                "time = {{ field = {} }}   # the messages' own time; without this line, when they were logged",
                quoted(stamp)
            );
        }
        if let Some(fs_hz) = sensor.fs_hz {
            let _ = writeln!(text, "fs_hz = {fs_hz:?}");
        }
        match thermometer {
        Some(Content { topic, field: Ok(field), unit: Some(unit), array_fs_hz, stamp, .. }) => {
            let _ = write!(
                text,
                "\n[rod.temperature]              # without it a warm day looks like a loss\ntopic = {}\nfield = {}\nunit = \"{}\"\n",
                quoted(topic),
                quoted(field),
                unit.key()
            );
            if let Some(stamp) = stamp {
                let _ = writeln!(text, "time = {{ field = {} }}", quoted(stamp));
            }
            if let Some(fs_hz) = array_fs_hz {
                let _ = writeln!(text, "fs_hz = {fs_hz:?}");
            }
        }
        _ => text.push_str(
            "\n# [rod.temperature]            # without it a warm day looks like a loss\n# topic = \"/air\"\n# unit = \"degC\"\n",
        ),
    }
        text.push_str("\n[record]\ncut = \"auto\"                   # the motion is recognised: ambient, pulls, blows; \"free-decay\" cuts a record at each release\n");
        text.push_str("\n# [store]                      # where `replay` and `run` keep their results\n# path = \"site.db\"\n");
        text
    }
}

/// First temperature channel.
pub fn thermometer(found: Option<&[Content]>) -> Option<&Content> {
    let is_temperature =
        |content: &&Content| content.unit.is_some_and(|unit| Unit::TEMPERATURE.contains(&unit));
    found?.iter().find(is_temperature)
}

/// Writes a file that must not exist, complete or not at all.
///
/// # Errors
/// It exists, or cannot be written.
pub fn save(path: &Path, text: &str) -> io::Result<()> {
    let mut file = std::fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .open(path)?;
    file.write_all(text.as_bytes())
        .and_then(|()| file.sync_all())
        .inspect_err(|_| {
            // Half a configuration is worse than none, and the fault is reported either way.
            let _ = std::fs::remove_file(path);
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::rod::beam::Quantity;
    use crate::analysis::rod::prior::Prior;
    use crate::command::rod_flags::Material;
    use crate::command::sections::Profile;
    use crate::config::Config;

    fn parsed(rod: Rod) -> Config {
        let sensor = Sensor {
            topic: "/a \"b\"\\".to_owned(),
            field: "value".to_owned(),
            stamp: Some("header.stamp".to_owned()),
            unit: Unit::StandardGravity,
            says_unit: true,
            fs_hz: None,
        };
        let template = Template {
            command: "init",
            site: "Sant'Anna \"x\"",
            id: "nave-3",
            rod: &rod,
            sensor: &sensor,
            thermometer: None,
        };
        let text = template.text();
        Config::parse(&text, "x.toml").unwrap_or_else(|faults| panic!("{faults}\n{text}"))
    }

    fn rod(profile: Profile, material: Material, expected: Option<Expected>) -> Rod {
        Rod {
            length_m: 9.5,
            profile,
            material,
            expected,
        }
    }

    #[test]
    fn what_is_written_is_valid_whatever_the_names() {
        for (profile, material, expected) in [
            (Profile::Square(0.07), Material::Iron, None),
            (
                Profile::Round(0.045),
                Material::Steel,
                Some(Expected::About(150e3)),
            ),
            (
                Profile::Rectangle(0.06, 0.02),
                Material::Iron,
                Some(Expected::Between(1e3, 1.001e3)),
            ),
            (Profile::Round(0.0004), Material::Steel, None),
        ] {
            let config = parsed(rod(profile, material, expected));
            let channel = &config.rods[0].channels.displacement;
            assert_eq!(
                (channel.topic.as_str(), channel.unit),
                ("/a \"b\"\\", Unit::StandardGravity)
            );
            assert_eq!(config.site, "Sant'Anna \"x\"");
            let section = config.rods[0].analysis.prior.parameterisation().section();
            assert_eq!(section.key(), profile.key());
        }
    }

    /// The range of a force contains 95 % of its prior; without one the prior reaches from 1 kN to yield.
    #[test]
    fn the_prior_of_the_force_is_what_was_said() {
        let prior = |expected| {
            let config = parsed(rod(Profile::Square(0.07), Material::Iron, expected));
            *config.rods[0].analysis.prior.of(Quantity::AxialForce).unwrap()
        };
        match prior(Some(Expected::Between(20e3, 200e3))) {
            Prior::LogNormal { median, log_sd } => {
                assert!((median * (-1.96 * log_sd).exp() / 20e3 - 1.0).abs() < 1e-3);
                assert!((median * (1.96 * log_sd).exp() / 200e3 - 1.0).abs() < 1e-3);
            }
            other => panic!("{other:?}"),
        }
        // 300 MPa over 49 cm^2.
        assert_eq!(
            prior(None),
            Prior::LogUniform {
                low: 1e3,
                high: 1.47e6
            }
        );
    }
}
