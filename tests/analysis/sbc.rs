//! Simulation-based calibration: truths drawn from the prior, records from the model, and the rank of
//! each truth in its posterior. The ranks are uniform if the posteriors are right (Talts et al. 2018).
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use rand_distr::{Distribution as _, StandardNormal};
use rayon::prelude::*;
use std::sync::Arc;
use tirante::analysis::inference::{
    AbcSettings, Accept, Adjustment, Distance, Inference, Method, Noise, Observation, Tables,
};
use tirante::analysis::numerics::{diagnostics, random};
use tirante::analysis::rod::beam::exact::Exact;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::beam::{Parameterisation, Quantity, Section};
use tirante::analysis::rod::fixity::Fixity;
use tirante::analysis::rod::prior::{Prior, RodPrior};

/// A campaign: how records are made and how they are judged.
#[derive(Clone, Copy)]
struct Campaign {
    records: usize,
    orders: &'static [usize],
    sd: f64,
    discrepancy: f64,
    settings: AbcSettings,
    /// The rod's prior.
    prior: fn() -> RodPrior,
    /// Factor on the force's prior mean from which truths are drawn; 1 for a right prior.
    misled: f64,
}

const CAMPAIGN: Campaign = Campaign {
    records: 1000,
    orders: &[1, 2, 3],
    sd: 0.01,
    discrepancy: 0.0,
    settings: AbcSettings {
        draws: 100_000,
        accept: Accept::Quantile(0.01),
        distance: Distance::Euclidean,
        noise: Noise::Record,
        method: Method::Rejection,
        adjustment: Adjustment::Linear,
    },
    prior: RodPrior::todi,
    misled: 1.0,
};

/// Ranks of the truth, one vector per uncertain quantity.
fn ranks(campaign: &Campaign) -> Vec<(Quantity, Vec<f64>)> {
    let prior = (campaign.prior)();
    let model = Arc::new(Exact::new(*prior.parameterisation()));
    let modes = *campaign.orders.last().unwrap();
    let inference = Inference::plan(
        prior.clone(),
        model.clone(),
        vec![campaign.discrepancy; modes],
        campaign.settings,
        modes,
        &Tables::new(1),
    )
    .unwrap();
    let mut priors = prior.priors().to_vec();
    if let Prior::TruncatedNormal { mean, .. } = &mut priors[0] {
        *mean *= campaign.misled;
    }
    let truth = RodPrior::new(*prior.parameterisation(), priors).unwrap();
    let quantities = &prior.parameterisation().quantities()[..6];
    let per_record: Vec<Vec<f64>> = (0..campaign.records as u64)
        .into_par_iter()
        .map(|record| {
            // Streams of another seed than the tables'.
            let mut generator = random::stream(0x5bc, record);
            let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
            let z: Vec<f64> = (0..2 * modes).map(|_| normal()).collect();
            let mut theta = vec![0.0; 7];
            truth.sample(&mut generator, &mut theta);
            let mut y = vec![0.0; modes];
            model.frequencies(&theta, &mut y).unwrap();
            let observed = campaign
                .orders
                .iter()
                .map(|&n| y[n - 1] * (1.0 + campaign.discrepancy * z[n - 1]) + campaign.sd * z[modes + n - 1])
                .collect();
            let sds = vec![campaign.sd; campaign.orders.len()];
            let observation = Observation {
                orders: campaign.orders.to_vec(),
                frequency_hz: observed,
                sd_hz: sds,
            };
            let posterior = inference
                .run(&observation, random::seed(&[&record.to_le_bytes()]))
                .unwrap();
            let rank = |(i, &q): (usize, &Quantity)| {
                diagnostics::rank(theta[i], &posterior.values(q).unwrap(), &posterior.weights)
            };
            quantities.iter().enumerate().map(rank).collect()
        })
        .collect();
    quantities
        .iter()
        .enumerate()
        .map(|(i, &q)| (q, per_record.iter().map(|row| row[i]).collect()))
        .collect()
}

/// Six quantities, two tests each, three campaigns: a right posterior fails one of these 36 tests at
/// the level 1e-4 with a probability below 0.4 %, and the seeds are fixed.
#[test]
fn ranks_are_uniform() {
    let misses_the_second = Campaign {
        orders: &[1, 3],
        sd: 0.0316,
        ..CAMPAIGN
    };
    let discrepant = Campaign {
        discrepancy: 0.01,
        ..CAMPAIGN
    };
    for campaign in [CAMPAIGN, misses_the_second, discrepant] {
        for (quantity, ranks) in ranks(&campaign) {
            let test = diagnostics::uniformity(&ranks, 20).unwrap();
            assert!(
                test.chi_square_p > 1e-4 && test.kolmogorov_smirnov_p > 1e-4,
                "{} {:?}: {test:?}",
                quantity.key(),
                campaign.orders
            );
        }
    }
}

/// Prior written by `init` for a rod of known size and material only: 9.5 m, 50 mm square, iron.
fn unknown_rod() -> RodPrior {
    let normal = |mean: f64, cv: f64| Prior::TruncatedNormal { mean, sd: cv * mean };
    let support = Prior::Fixity(Fixity {
        low: 0.0,
        high: 0.99,
        ends: 2.0,
        unit_n_m: 1.0,
    });
    let priors = vec![
        Prior::LogUniform {
            low: 1e3,
            high: 7.5e5,
        },
        normal(190e9, 0.10),
        normal(7650.0, 0.03),
        normal(0.05, 0.02),
        support,
        support,
        Prior::Fixed { value: 9.5 },
    ];
    RodPrior::new(Parameterisation::new(Section::Square), priors)
        .unwrap()
        .with_fixities_in_place()
}

/// A force anywhere between slack and yield, supports anywhere between hinge and clamp: the force is right all the same. Of N alone:
/// of the wide prior the nearest draws lie some per cent away, and what is left of that tolerance is seen in the modulus.
#[test]
fn ranks_are_uniform_when_little_is_known() {
    let wide = Campaign {
        orders: &[1, 2, 3],
        discrepancy: 0.01,
        settings: AbcSettings::default(),
        prior: unknown_rod,
        ..CAMPAIGN
    };
    let exact = Campaign {
        discrepancy: 0.003,
        orders: &[1, 2, 3, 4, 5],
        ..wide
    };
    let first_alone = Campaign { orders: &[1], ..wide };
    for campaign in [wide, exact, first_alone] {
        let ranks = ranks(&campaign);
        let (quantity, force) = &ranks[0];
        assert_eq!(*quantity, Quantity::AxialForce);
        let test = diagnostics::uniformity(force, 20).unwrap();
        let covered = force.iter().filter(|&&r| r > 0.025 && r < 0.975).count();
        println!(
            "{:?} {:?} {test:?} {covered}",
            campaign.orders, campaign.discrepancy
        );
        assert!(
            test.chi_square_p > 1e-4 && test.kolmogorov_smirnov_p > 1e-4,
            "{:?} {test:?}",
            campaign.orders
        );
        // 950 of 1000 give or take 7.
        assert!((925..=975).contains(&covered), "{:?} {covered}", campaign.orders);
    }
}

/// The test detects a wrong prior: truths whose force is 10 % (half a prior standard deviation) above the
/// prior of the inference.
#[test]
fn a_wrong_prior_is_seen() {
    let misled = Campaign {
        misled: 1.1,
        ..CAMPAIGN
    };
    let ranks = ranks(&misled);
    let (quantity, force) = &ranks[0];
    assert_eq!(*quantity, Quantity::AxialForce);
    let test = diagnostics::uniformity(force, 20).unwrap();
    assert!(
        test.chi_square_p < 1e-6 && test.kolmogorov_smirnov_p < 1e-6,
        "{test:?}"
    );
}

#[test]
#[ignore = "campaign: 20 000 records per setting, about 4 minutes; run with --release --ignored --nocapture long"]
fn long() {
    let paper = AbcSettings {
        draws: 10_000,
        noise: Noise::Record,
        adjustment: Adjustment::None,
        ..CAMPAIGN.settings
    };
    let million = AbcSettings {
        draws: 1_000_000,
        ..CAMPAIGN.settings
    };
    let default = AbcSettings::default();
    let plain = AbcSettings {
        adjustment: Adjustment::None,
        ..default
    };
    let sequential = AbcSettings {
        draws: 50_000,
        accept: Accept::Quantile(0.02),
        method: Method::Sequential,
        ..default
    };
    for (name, campaign) in [
        (
            "defaults, 10 mHz",
            Campaign {
                settings: default,
                ..CAMPAIGN
            },
        ),
        (
            "defaults, 2 mHz",
            Campaign {
                settings: default,
                sd: 0.002,
                ..CAMPAIGN
            },
        ),
        (
            "defaults, 31.6 mHz",
            Campaign {
                settings: default,
                sd: 0.0316,
                ..CAMPAIGN
            },
        ),
        (
            "defaults, modes 1 and 3",
            Campaign {
                settings: default,
                orders: &[1, 3],
                ..CAMPAIGN
            },
        ),
        (
            "defaults, five modes",
            Campaign {
                settings: default,
                orders: &[1, 2, 3, 4, 5],
                ..CAMPAIGN
            },
        ),
        (
            "defaults, discrepancy 1 %",
            Campaign {
                settings: default,
                discrepancy: 0.01,
                ..CAMPAIGN
            },
        ),
        (
            "1 000 000 draws, 10 mHz",
            Campaign {
                settings: million,
                ..CAMPAIGN
            },
        ),
        (
            "no adjustment, 10 mHz",
            Campaign {
                settings: plain,
                ..CAMPAIGN
            },
        ),
        (
            "the paper's 100 of 10 000, 31.6 mHz",
            Campaign {
                settings: paper,
                sd: 0.0316,
                ..CAMPAIGN
            },
        ),
        (
            "sequence, 10 mHz (1000 records)",
            Campaign {
                settings: sequential,
                ..CAMPAIGN
            },
        ),
    ] {
        let records = if name.starts_with("sequence") {
            1000
        } else {
            20_000
        };
        println!("{name}");
        for (quantity, ranks) in ranks(&Campaign { records, ..campaign }) {
            let test = diagnostics::uniformity(&ranks, 20).unwrap();
            let covered = |level: f64| {
                let tail = 0.5 * (1.0 - level);
                let inside = ranks.iter().filter(|&&r| r > tail && r < 1.0 - tail).count();
                100.0 * inside as f64 / ranks.len() as f64
            };
            println!(
                "  {:18} chi-square p {:.3}, KS p {:.3} (D {:.4}); 50 % intervals cover {:.1} %, 95 % {:.1} %",
                quantity.key(),
                test.chi_square_p,
                test.kolmogorov_smirnov_p,
                test.kolmogorov_smirnov,
                covered(0.5),
                covered(0.95)
            );
        }
    }
}
