//! Campaign: finite elements against the exact model over ten decades of slenderness.

use rand::RngExt;
use std::f64::consts::PI;
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::{Beam, exact, finite_elements};

#[test]
#[ignore = "campaign: 300 000 beams from string to stub, a minute; run with --release --ignored"]
fn no_mode_is_missed_or_swapped_over_ten_decades() {
    let mut generator = random::stream(20, 0);
    let mut worst: [f64; 2] = [0.0; 2];
    for case in 0..300_000 {
        let lambda = 10f64.powf(generator.random_range(-6.0..4.0));
        let elements = generator.random_range(8..=100);
        // Every third end is a hinge, a clamp, or anything between.
        let ends = [0, 1].map(|_| match generator.random_range(0..3) {
            0 => 0.0,
            1 => f64::INFINITY,
            _ => 10f64.powf(generator.random_range(-8.0..8.0)) * lambda,
        });
        let beam = Beam {
            length_m: 1.0,
            flexural_rigidity_n_m2: lambda * lambda,
            mass_per_length_kg_m: 1.0,
            axial_force_n: 1.0,
            end_stiffness_n_m: ends,
        };
        let (mut fe, mut closed) = ([0.0; 5], [0.0; 5]);
        finite_elements::frequencies(&beam, elements, &mut fe).unwrap();
        exact::frequencies(&beam, &mut closed).unwrap();
        for i in 0..5 {
            let error = fe[i] / closed[i] - 1.0;
            let h = 1.0 / elements as f64;
            let wave = ((i + 2) as f64 * PI * h).powi(4) / 1440.0;
            let layer = 0.5 * h * (h / lambda).min(1.0).powi(4);
            worst = [worst[0].min(error), worst[1].max(error / (2.0 * wave + layer))];
            assert!(
                error > -1e-9 && error < 2.0 * wave + layer + 1e-9,
                "{case} {beam:?} {elements} {i} {error:e}"
            );
        }
    }
    eprintln!(
        "lowest error {:.1e}, largest share of the bound {:.2}",
        worst[0], worst[1]
    );
}
