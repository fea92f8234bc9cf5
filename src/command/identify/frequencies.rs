//! Frequencies and their standard errors as flags give them.

use crate::analysis::rod::beam::forward::MAX_MODES;
use crate::analysis::signal::modes::Mode;
use crate::command::BadArguments;
use crate::config::written;

/// Standard error of a frequency given without one \[Hz\]: the paper's Sigma = 1e-3 Hz^2.
const DEFAULT_SD_HZ: f64 = 0.031_622_776_601_683_79;

/// Highest frequency accepted; no rod vibrates faster \[Hz\].
const HIGHEST_HZ: f64 = 1e5;

/// Modes from the list of one flag, with the errors of another; says which error is assumed without it.
pub(super) fn modes_of(
    (flag, list): (&str, &str),
    (sd_flag, sd): (&str, Option<&str>),
) -> anyhow::Result<Vec<Mode>> {
    let modes = parse_modes((flag, list), (sd_flag, sd))?;
    if sd.is_none() {
        tell!(
            "no {sd_flag}: every frequency of {flag} is taken with the paper's standard error of 0.0316 Hz"
        );
    }
    Ok(modes)
}

fn parse_modes((flag, list): (&str, &str), (sd_flag, sd): (&str, Option<&str>)) -> anyhow::Result<Vec<Mode>> {
    let frequencies = parse_list(flag, list)?;
    let sds = sd.map(|sd| parse_list(sd_flag, sd)).transpose()?;
    if let Some(sds) = &sds
        && sds.len() != 1
        && sds.len() != frequencies.len()
    {
        let message = format!(
            "{sd_flag} has {} entries, {flag} {}",
            sds.len(),
            frequencies.len()
        );
        return Err(BadArguments(message).into());
    }
    let mut modes: Vec<Mode> = Vec::new();
    for (index, frequency) in frequencies.iter().enumerate() {
        let Some(frequency_hz) = *frequency else { continue };
        let order = index + 1;
        let sd_hz = match sds.as_deref() {
            None => DEFAULT_SD_HZ,
            Some([one]) => one.ok_or_else(|| BadArguments(format!("{sd_flag}: '-' alone gives no error")))?,
            Some(list) => list[index].ok_or_else(|| {
                BadArguments(format!("{sd_flag}: mode {order} was measured, its error is '-'"))
            })?,
        };
        if modes
            .last()
            .is_some_and(|before| before.frequency_hz >= frequency_hz)
        {
            let message = format!("{flag}: mode {order} at {frequency_hz} Hz is not above the one before");
            return Err(BadArguments(message).into());
        }
        modes.push(Mode {
            order,
            frequency_hz,
            sd_hz,
            damping: None,
        });
    }
    if modes.is_empty() {
        return Err(BadArguments(format!("{flag}: no mode was measured")).into());
    }
    if let Some(mode) = modes.last()
        && mode.order > MAX_MODES
    {
        let message = format!("{flag}: at most {} modes are used", MAX_MODES);
        return Err(BadArguments(message).into());
    }
    Ok(modes)
}

fn parse_list(flag: &str, text: &str) -> anyhow::Result<Vec<Option<f64>>> {
    let entries = written::list(text).map_err(|why| BadArguments(format!("{flag}: {why}")))?;
    entries
        .into_iter()
        .map(|entry| match entry {
            "-" | "" => Ok(None),
            number => match written::decimal(number) {
                Err(why) if number.contains(',') => Err(BadArguments(format!("{flag}: {why}")).into()),
                Ok(value) if value > 0.0 && value <= HIGHEST_HZ => Ok(Some(value)),
                _ => Err(BadArguments(format!(
                    "{flag}: '{number}' is no number of hertz above 0 and up to {HIGHEST_HZ}"
                ))
                .into()),
            },
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn modes(frequencies: &str, sd: Option<&str>) -> anyhow::Result<Vec<Mode>> {
        parse_modes(("--frequencies", frequencies), ("--sd", sd))
    }

    #[test]
    fn missing_modes_keep_their_place() {
        let found = modes("4.492,-,13.252", Some("0.005,-,0.01")).unwrap();
        assert_eq!(found.iter().map(|mode| mode.order).collect::<Vec<_>>(), [1, 3]);
        assert_eq!(found[1].sd_hz, 0.01);
    }

    #[test]
    fn one_error_serves_all_and_none_is_the_papers() {
        let both = modes("4.5,9.3", Some("0.002")).unwrap();
        assert!(both.iter().all(|mode| mode.sd_hz == 0.002));
        let one = modes("4.5", None).unwrap();
        assert!((one[0].sd_hz.powi(2) - 1e-3).abs() < 1e-18);
    }

    #[test]
    fn nonsense_is_refused() {
        for (frequencies, sd) in [
            ("", None),
            ("-,-", None),
            ("4.5,abc", None),
            ("4.5,nan", None),
            ("-4.5", None),
            ("9.3,4.5", None),
            ("1,2,3,4,5,6", None),
            ("4.5,9.3", Some("0.1,0.1,0.1")),
            ("4.5,9.3", Some("0.1,-")),
            ("4.5", Some("-")),
            ("4.5", Some("0")),
            ("4,492", Some("0.1")),
            ("4,5", Some("0.1")),
            ("4.5", Some("0,01")),
        ] {
            assert!(modes(frequencies, sd).is_err(), "{frequencies} {sd:?}");
        }
    }

    #[test]
    fn a_fault_names_the_flag_it_stands_in() {
        for (frequencies, sd, flag) in [
            ("9.5,8.0", None, "--mass-frequencies: mode 2"),
            (
                "9.5,18.0",
                Some("0.1,0.1,0.1"),
                "--mass-sd has 3 entries, --mass-frequencies 2",
            ),
            ("9.5", Some("-"), "--mass-sd: "),
            ("9,5", None, "--mass-frequencies: a comma"),
            ("-", None, "--mass-frequencies: no mode"),
        ] {
            let said = parse_modes(("--mass-frequencies", frequencies), ("--mass-sd", sd));
            let said = said.unwrap_err().to_string();
            assert!(said.starts_with(flag), "{frequencies}: {said}");
        }
        let commas = modes("4,49; 9,28", None).unwrap();
        assert_eq!((commas[0].frequency_hz, commas[1].frequency_hz), (4.49, 9.28));
    }
}
