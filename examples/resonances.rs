//! Resonances of one column of numbers on stdin: `resonances FS_HZ LOW_HZ HIGH_HZ [decay] < samples.txt`.

use std::io::Read;
use tirante::bayes::RodPrior;
use tirante::modes::{LabelPlan, ModalPlan, ModeSettings};
use tirante::record::{Excitation, Record, RodId, Timestamp};
use tirante::spectrum::{PeakSettings, WelchSettings};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize| {
        args.get(i)
            .ok_or("usage: resonances FS_HZ LOW_HZ HIGH_HZ [decay]")?
            .parse::<f64>()
            .map_err(|e| e.to_string())
    };
    let (fs_hz, low_hz, high_hz) = (number(0)?, number(1)?, number(2)?);
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text)?;
    let samples = text
        .split_whitespace()
        .map(str::parse)
        .collect::<Result<Vec<f64>, _>>()?;
    let excitation = if args.get(3).is_some_and(|a| a == "decay") {
        Excitation::FreeDecay
    } else {
        Excitation::Ambient
    };
    let record = Record {
        rod: RodId("stdin".into()),
        start: Timestamp::from_nanos(0),
        fs_hz,
        samples,
        temperature_c: None,
        readings: Vec::new(),
        excitation: Some(excitation),
        clock_sd: 0.0,
        flags: Vec::new(),
    };
    // A rod is needed for labels only.
    let unused = LabelPlan::new(&RodPrior::todi(), &[], ModeSettings::default()).ok_or("no rod")?;
    let plan = ModalPlan::new(WelchSettings::default(), PeakSettings::default(), unused);
    let evidence = plan.evidence(&record, low_hz, high_hz)?;
    let (spectrum, resonances) = (evidence.spectrum, evidence.resonances);
    println!(
        "{:.1} s, {} segments, lines {:.4} Hz apart",
        record.duration_s(),
        spectrum.segments,
        spectrum.df_hz
    );
    println!("frequency_hz sd_hz damping_% peak_to_noise_db evidence");
    for r in resonances {
        println!(
            "{:12.4} {:.4} {:8.3} {:10.1} {:14.1}{}",
            r.frequency_hz,
            r.frequency_sd_hz,
            100.0 * r.damping,
            10.0 * r.peak_to_noise.log10(),
            r.evidence,
            if r.line { " line" } else { "" }
        );
    }
    Ok(())
}
