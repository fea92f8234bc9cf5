//! Settings of a simulation: the campaign, the rods and their truth, the weather, the sensors, the faults.

use crate::rod::beam::Section;
use crate::rod::beam::shape::Shape;
use crate::signal::record::{Channel, RodId, Timestamp};

/// A whole simulation: the same records of every rod.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// Sample rate \[Hz\].
    pub fs_hz: f64,
    /// Time of the first sample.
    pub start: Timestamp,
    /// Length of a record \[s\].
    pub record_s: f64,
    /// Number of records.
    pub records: usize,
    /// From the start of a record to the start of the next \[s\].
    pub interval_s: f64,
    /// Number of samples in one message; 1 writes scalars.
    pub samples_per_message: usize,
    /// The weather, if temperature plays a part.
    pub climate: Option<Climate>,
    /// The rods.
    pub rods: Vec<SimulatedRod>,
}

/// Air temperature: T = mean + season + day + weather, where season and day are cosines and the weather
/// is a stationary Ornstein-Uhlenbeck process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Climate {
    /// Mean of the year \[degC\].
    pub mean_c: f64,
    /// Amplitude of the season, half of the range \[K\].
    pub season_k: f64,
    /// Day of the year of the seasonal maximum \[d\].
    pub warmest_day: f64,
    /// Amplitude of the day, half of the range \[K\].
    pub day_k: f64,
    /// Hour (UTC) of the daily maximum \[h\].
    pub warmest_hour: f64,
    /// Standard deviation of the weather \[K\].
    pub weather_k: f64,
    /// Correlation time of the weather \[d\].
    pub weather_d: f64,
    /// Standard deviation of the thermometer's noise \[K\].
    pub noise_k: f64,
    /// From one temperature message to the next within a record \[s\].
    pub every_s: f64,
    /// From one temperature message to the next between records \[s\]; `None`: within records only.
    pub between_s: Option<f64>,
}

/// One simulated rod.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedRod {
    /// Id of the rod.
    pub rod: RodId,
    /// Channel of its displacement.
    pub displacement: Channel,
    /// Channel of its temperature, if measured.
    pub temperature: Option<Channel>,
    /// True state of the rod.
    pub truth: Truth,
    /// Damping ratio of each mode simulated, from the first \[-\].
    pub damping: Vec<f64>,
    /// Standard deviation of the first mode's ambient response at its antinode \[m\]; the other modes
    /// follow from the same white load.
    pub ambient_m: f64,
    /// Gusts of the ambient load, if it is not stationary.
    pub gusts: Option<Gusts>,
    /// Pulls or blows, if any.
    pub pull: Option<Pull>,
    /// Knocks at random times, if any.
    pub knocks: Option<Knocks>,
    /// A similar rod beside it, if any.
    pub neighbour: Option<Neighbour>,
    /// Resonances of other structures in the sensor's signal.
    pub resonances: Vec<Resonance>,
    /// The sensor.
    pub sensor: Sensor,
    /// Further sensors that see the same motion.
    pub further: Vec<FurtherSensor>,
    /// Sinusoids that are no modes: mains hum, a motor.
    pub interference: Vec<Line>,
    /// Effect of temperature on the axial force.
    pub thermal: Thermal,
    /// Changes of the axial force besides temperature.
    pub changes: Vec<Change>,
    /// Mass hung onto the rod, if any.
    pub added_mass: Option<AddedMass>,
    /// Faults of sensor, clock and transport.
    pub faults: Vec<Fault>,
}

/// True state of a simulated rod.
#[derive(Debug, Clone, PartialEq)]
pub enum Truth {
    /// A beam: one value per quantity of the section, in its order, SI.
    Beam {
        /// The section.
        section: Section,
        /// Values of the quantities, SI.
        theta: Vec<f64>,
    },
    /// Natural frequencies without a beam behind them \[Hz\], ascending; mode shapes are sines.
    Frequencies(Vec<f64>),
}

/// Scheduled excitation of free vibration, beside the ambient load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pull {
    /// A slow pull and sudden release, or a blow.
    pub kind: PullKind,
    /// Place as a share of the length, 0 to 1.
    pub at: f64,
    /// Deflection at that place on release \[m\]; for a blow, the first mode's amplitude at its antinode.
    pub deflection_m: f64,
    /// Time of the first release from the start of each record; before 0 the record begins inside the decay \[s\].
    pub first_s: f64,
    /// From one release to the next \[s\].
    pub every_s: f64,
    /// Duration of the pull before a release \[s\].
    pub ramp_s: f64,
}

/// Gusts: the ambient load's amplitude is exp(x) with x a stationary Ornstein-Uhlenbeck process, its mean square one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gusts {
    /// Standard deviation of ln amplitude; 0.6 is some 5 dB \[-\].
    pub log_sd: f64,
    /// Correlation time of ln amplitude \[s\].
    pub correlation_s: f64,
}

/// Blows at random times, of random size and sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knocks {
    /// Mean time from one to the next; the gaps are exponential \[s\].
    pub every_s: f64,
    /// Place as a share of the length, 0 to 1.
    pub at: f64,
    /// Median of the first mode's amplitude at its antinode \[m\].
    pub deflection_m: f64,
    /// Standard deviation of ln deflection \[-\].
    pub log_sd: f64,
}

/// A rod of the same make beside this one, whose vibration reaches the sensor through the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Its frequencies over the rod's, less one \[-\].
    pub detuning: f64,
    /// Share of its vibration in the sensor's signal \[-\].
    pub share: f64,
}

/// A resonance that is no mode of the rod, under the same gusts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resonance {
    /// Its natural frequency \[Hz\].
    pub frequency_hz: f64,
    /// Its damping ratio \[-\].
    pub damping: f64,
    /// Standard deviation of its part of the sensor's signal \[m\].
    pub ambient_m: f64,
}

/// Kind of excitation of free vibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PullKind {
    /// A point force that grows slowly and then vanishes: starts from the static shape at rest.
    Release,
    /// A point impulse: starts from the straight rod with a velocity.
    Blow,
}

/// The sensor of one rod.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    /// Place as a share of the length, 0 to 1; at one half no even mode of a symmetric rod is visible.
    pub at: f64,
    /// Standard deviation of its white noise, per sample \[m\].
    pub noise_m: f64,
    /// Standard deviation of its 1/f noise above 1 mHz \[m\].
    pub pink_m: f64,
    /// Smallest step of its output \[m\]; 0 is none.
    pub resolution_m: f64,
}

impl Sensor {
    /// Modal amplitude that it sees of a shape.
    pub fn sees(&self, shape: &Shape) -> f64 {
        shape.at(self.at)
    }
}

/// A further sensor of a rod: of displacement, or of the strain of its face.
#[derive(Debug, Clone, PartialEq)]
pub struct FurtherSensor {
    /// Channel of its samples.
    pub channel: Channel,
    /// Place and noise, in the SI unit of its channel.
    pub sensor: Sensor,
    /// Half the height of the section, for a strain gauge \[m\].
    pub strain_over_m: Option<f64>,
}

impl FurtherSensor {
    /// Modal amplitude that it sees of a shape: strain is `-h w'' / 2`.
    pub fn sees(&self, shape: &Shape) -> f64 {
        match self.strain_over_m {
            Some(half_height_m) => -half_height_m * shape.derivatives(self.sensor.at).1,
            None => self.sensor.sees(shape),
        }
    }
}

/// A sinusoid that is no mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Its frequency \[Hz\].
    pub frequency_hz: f64,
    /// Its amplitude \[m\].
    pub amplitude_m: f64,
}

/// Effect of temperature on the axial force: N = N_0 - kappa E A alpha (T_rod - T_ref).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thermal {
    /// Restraint kappa of the ends, 0 free to 1 rigid \[-\].
    pub restraint: f64,
    /// Expansion coefficient alpha \[1/K\].
    pub expansion_per_k: f64,
    /// Axial rigidity E A \[N\]; `None`: E and A of the truth.
    pub axial_rigidity_n: Option<f64>,
    /// Temperature at which the truth's axial force holds \[degC\]; `None`: the climate's mean.
    pub reference_c: Option<f64>,
    /// Time constant with which the rod follows the air \[h\].
    pub lag_h: f64,
}

/// A change of the axial force: from `start_d` it grows linearly over `over_d` and stays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// Begin, from the start of the simulation \[d\].
    pub start_d: f64,
    /// Duration \[d\]; 0 is a step.
    pub over_d: f64,
    /// Final change as a share of the truth's axial force \[-\].
    pub relative: f64,
}

impl Change {
    /// Change reached after `days` days, as a share of the truth's axial force.
    pub(super) fn after(&self, days: f64) -> f64 {
        let since = days - self.start_d;
        let done = if since < 0.0 {
            0.0
        } else if self.over_d > 0.0 {
            (since / self.over_d).min(1.0)
        } else {
            1.0
        };
        self.relative * done
    }
}

/// A mass hung onto the rod.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AddedMass {
    /// Mass \[kg\].
    pub mass_kg: f64,
    /// Place as a share of the length, 0 to 1.
    pub at: f64,
    /// Start, from the start of the simulation \[d\].
    pub start_d: f64,
}

/// A fault of some records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// Kind of the fault.
    pub kind: FaultKind,
    /// First record affected, from 1.
    pub first_record: usize,
    /// Last record affected, from 1.
    pub last_record: usize,
}

/// Kind of a fault. Times are from the start of the record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultKind {
    /// Samples are not a number from `at_s` for `length_s`.
    Nan {
        /// Begin \[s\].
        at_s: f64,
        /// Duration \[s\].
        length_s: f64,
    },
    /// Messages that hold a sample from `at_s` for `length_s` are not sent.
    Dropout {
        /// Begin \[s\].
        at_s: f64,
        /// Duration \[s\].
        length_s: f64,
    },
    /// The output repeats its last value.
    Held {
        /// Begin \[s\].
        at_s: f64,
        /// Duration \[s\].
        length_s: f64,
    },
    /// Isolated wrong samples of random sign.
    Spikes {
        /// Mean number in an hour \[1/h\].
        per_hour: f64,
        /// Height \[m\].
        height_m: f64,
    },
    /// The output never leaves plus or minus the level.
    Clipped {
        /// Level \[m\].
        level_m: f64,
    },
    /// The output jumps and stays.
    Step {
        /// Time \[s\].
        at_s: f64,
        /// Height \[m\].
        height_m: f64,
    },
    /// The output is in another unit from the start of the record.
    Scaled {
        /// Factor \[-\].
        factor: f64,
    },
    /// The clock jumps by `step_s` at `at_s` and stays wrong until the record's end.
    ClockStep {
        /// Time \[s\].
        at_s: f64,
        /// Size of the jump, negative is backwards \[s\].
        step_s: f64,
    },
    /// The message that holds the sample at `at_s` is stamped late, all others correctly.
    Late {
        /// Time \[s\].
        at_s: f64,
        /// Delay \[s\].
        late_s: f64,
    },
    /// The stamps scatter.
    Jitter {
        /// Standard deviation \[s\].
        sd_s: f64,
    },
    /// Messages are sent twice.
    Duplicates {
        /// Share of the messages.
        share: f64,
    },
    /// Messages are swapped with the next.
    OutOfOrder {
        /// Share of the messages.
        share: f64,
    },
    /// Messages are lost one by one.
    Lost {
        /// Share of the messages.
        share: f64,
    },
}

impl FaultKind {
    /// Name in configuration.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Nan { .. } => "nan",
            Self::Dropout { .. } => "dropout",
            Self::Held { .. } => "held",
            Self::Spikes { .. } => "spikes",
            Self::Clipped { .. } => "clipped",
            Self::Step { .. } => "step",
            Self::Scaled { .. } => "scaled",
            Self::ClockStep { .. } => "clock-step",
            Self::Late { .. } => "late",
            Self::Jitter { .. } => "jitter",
            Self::Duplicates { .. } => "duplicates",
            Self::OutOfOrder { .. } => "out-of-order",
            Self::Lost { .. } => "lost",
        }
    }
}
