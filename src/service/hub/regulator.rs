//! The pause that sites with a backlog are asked for, so that a message waits in the stream for seconds whoever comes back.
//!
//! All sites share one stream, which is folded in its order. The rate $A$ at which messages come is inverse to the pause, so the
//! pause is multiplied, once a second, by a power of $A / A^*$, with the rate $A^* = F (1 - (w - w_0) / \tau)$ that brings the wait
//! $w$ back to the aim $w_0$ within about $\tau$; $F$ is the rate of folding.

use crate::service::forward::throttle::{LONGEST_S, Pause};

/// Wait that is aimed at \[s\].
const AIM_S: f64 = 5.0;
/// Time in which a longer one is brought back \[s\].
const BACK_S: f64 = 20.0;
/// Bounds of $A^* / F$.
const ALLOWED: (f64, f64) = (0.1, 1.5);
/// Bounds of the first pause, once the aim is missed, and the shortest that is asked for \[s\].
const FIRST_S: (f64, f64) = (1.0, 60.0);
const SHORTEST_S: f64 = 0.05;
/// Power of $A / A^*$, and bounds of the factor: $A$ follows the pause late, and is noisy.
const POWER: f64 = 0.5;
const FACTOR: (f64, f64) = (0.5, 2.0);
/// Wait under which the pause is shortened beside that, and its factor then: the hub is about to be idle.
const IDLE_S: f64 = 1.0;
const SHORTEN: f64 = 0.8;
/// Weights of the latest look in $A$ and $F$; share of $F$ that is kept for a second in which less was there to fold.
const LATEST: f64 = 0.3;
const LATEST_FOLDED: f64 = 0.5;
const KEEP: f64 = 0.9;
/// Longest pause, in times of the one that lets all sites together send as much as is folded.
const LONGEST: f64 = 2.0;

/// Rates of stream and folding, and the pause that follows from them.
#[derive(Debug)]
pub struct Regulator {
    /// Number of sites on the list: as many may have come back when the aim is missed.
    sites: usize,
    /// Time, the stream's last message and the last one folded, at the latest look.
    latest: Option<(f64, u64, u64)>,
    coming_hz: f64,
    folding_hz: f64,
    /// 0 while none is asked for.
    pause_s: f64,
}

impl Regulator {
    /// A regulator of so many sites.
    pub fn new(sites: usize) -> Self {
        Self {
            sites,
            latest: None,
            coming_hz: 0.0,
            folding_hz: 0.0,
            pause_s: 0.0,
        }
    }

    /// Takes the numbers of the stream's last message and of the last one folded, about once a second; returns what sites with a
    /// backlog are asked for, if anything.
    pub fn look(&mut self, now_s: f64, last: u64, folded: u64) -> Option<Pause> {
        let before = self.latest.replace((now_s, last, folded));
        let (then_s, last_then, folded_then) = before?;
        let took_s = now_s - then_s;
        // A stream that was set back is looked at from its beginning.
        let (Some(came), Some(done)) = (last.checked_sub(last_then), folded.checked_sub(folded_then)) else {
            return None;
        };
        if took_s <= 0.0 {
            return None;
        }
        self.coming_hz += LATEST * (came as f64 / took_s - self.coming_hz);
        let done_hz = done as f64 / took_s;
        // Where less was there than could be folded, the rate says little, and where nothing was, nothing.
        let is_busy = done > 0 && last_then.saturating_sub(folded_then) >= done;
        if is_busy && self.folding_hz > 0.0 {
            self.folding_hz += LATEST_FOLDED * (done_hz - self.folding_hz);
        } else if done > 0 {
            self.folding_hz = done_hz.max(self.folding_hz * KEEP.powf(took_s));
        }
        if self.folding_hz <= 0.0 {
            return None;
        }
        let wait_s = last.saturating_sub(folded) as f64 / self.folding_hz;
        if self.pause_s > 0.0 {
            let share = (1.0 - (wait_s - AIM_S) / BACK_S).clamp(ALLOWED.0, ALLOWED.1);
            let ratio = self.coming_hz / (share * self.folding_hz);
            self.pause_s *= ratio.powf(POWER).clamp(FACTOR.0, FACTOR.1);
            if wait_s < IDLE_S {
                self.pause_s *= SHORTEN;
            }
            if self.pause_s < SHORTEST_S {
                self.pause_s = 0.0;
            }
            let longest_s = LONGEST * self.sites as f64 / self.folding_hz;
            self.pause_s = self.pause_s.min(longest_s.clamp(FIRST_S.1, LONGEST_S));
        } else if is_busy && wait_s > AIM_S {
            self.pause_s = (self.sites as f64 / self.folding_hz).clamp(FIRST_S.0, FIRST_S.1);
        }
        (self.pause_s > 0.0).then_some(Pause {
            pause_s: self.pause_s,
            wait_s,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::numerics::random;
    use crate::service::forward::throttle::Throttle;
    use rand::RngExt;
    use std::collections::VecDeque;
    use std::time::{Duration, Instant};

    /// Step of the time: a site hears that a message is stored, and sends the next \[s\].
    const STEP_S: f64 = 0.01;
    /// Most messages the hub reads at once, and most commits it writes at once.
    const READ: usize = 33;
    const WRITTEN: i64 = 700;

    struct Site {
        throttle: Throttle,
        waiting: i64,
        /// Time at which it looks again \[s\].
        due_s: f64,
    }

    /// Sites with the same backlog come back within `spread_s`, while others send 17 commits a second; the hub folds `rate_hz`
    /// commits a second. Returns the duration and the waits of the new commits in order.
    fn come_back(sites: usize, backlog: i64, rate_hz: f64, spread_s: f64) -> (f64, Vec<f64>) {
        let (origin, mut chance) = (Instant::now(), random::stream(11, 0));
        let mut sites: Vec<Site> = (0..sites)
            .map(|site| Site {
                throttle: Throttle::new(site as u64),
                waiting: backlog,
                due_s: spread_s * chance.random::<f64>(),
            })
            .collect();
        // Commits of each message, and the time of a new one.
        let mut stream = VecDeque::<(i64, Option<f64>)>::new();
        let (mut read, mut written) = (VecDeque::new(), Vec::new());
        let (mut last, mut folded, mut until_s) = (0, 0, 0.0);
        let (mut regulator, mut looked_s, mut waits) = (Regulator::new(sites.len()), 0.0, Vec::new());
        let (mut t_s, mut next_live_s) = (0.0, 0.0);
        loop {
            t_s += STEP_S;
            let now = origin + Duration::from_secs_f64(t_s);
            while next_live_s < t_s {
                stream.push_back((1, Some(next_live_s)));
                last += 1;
                next_live_s -= chance.random::<f64>().ln() / 17.0;
            }
            for site in sites
                .iter_mut()
                .filter(|site| site.waiting > 0 && site.due_s <= t_s)
            {
                if let Some(wait) = site.throttle.wait(site.waiting, now) {
                    site.due_s = t_s + wait.as_secs_f64().min(1.0);
                    continue;
                }
                let sent = site.waiting.min(site.throttle.most(site.waiting, now) as i64);
                site.throttle.sent(site.waiting, now);
                site.waiting -= sent;
                stream.push_back((sent, None));
                last += 1;
            }
            if t_s < until_s {
                continue;
            }
            // What was written is there, and the next of what was read is written.
            folded += written.len() as u64;
            let new = written
                .drain(..)
                .filter_map(|(_, came_s): (i64, Option<f64>)| came_s);
            waits.extend(new.map(|came_s| t_s - came_s));
            if t_s - looked_s >= 1.0 {
                looked_s = t_s;
                if let Some(pause) = regulator.look(t_s, last, folded) {
                    let asked = serde_json::to_vec(&pause).unwrap();
                    for site in &mut sites {
                        site.throttle.take(&asked, now);
                    }
                }
            }
            if read.is_empty() {
                read.extend(stream.drain(..READ.min(stream.len())));
            }
            let mut commits = 0;
            while let Some(message) = read.pop_front() {
                // A message costs a commit more than it holds.
                commits += message.0 + 1;
                written.push(message);
                if commits >= WRITTEN {
                    break;
                }
            }
            until_s = t_s + commits as f64 / rate_hz;
            if written.is_empty() && sites.iter().all(|site| site.waiting == 0) {
                waits.sort_by(f64::total_cmp);
                return (t_s, waits);
            }
        }
    }

    #[test]
    fn what_is_new_does_not_wait_for_what_is_old_whoever_comes_back() {
        // Sites, backlog [commits], rate [commits/s], spread [s]. A minute is promised, and the backlog within twice its least time.
        for (sites, backlog, rate_hz, spread_s) in [
            (1, 3000, 2000.0, 0.0),
            (10, 50_000, 2000.0, 0.0),
            (100, 3000, 500.0, 3.0),
            (100, 3000, 2000.0, 3.0),
            (2000, 360, 2000.0, 3.0),
        ] {
            let (took_s, waits) = come_back(sites, backlog, rate_hz, spread_s);
            let at = waits[waits.len() * 99 / 100];
            let least_s = sites as f64 * backlog as f64 / rate_hz;
            println!(
                "{sites} sites, {backlog} commits, {rate_hz} a second: {took_s:.0} s, at least {least_s:.0}; 99 % within {at:.1} s"
            );
            assert!(at < 60.0, "{sites} sites: {at}");
            assert!(took_s < 20.0 + 2.0 * least_s, "{sites} sites: {took_s}");
        }
    }

    #[test]
    fn nothing_is_asked_for_while_the_hub_keeps_up_or_folds_nothing() {
        let mut regulator = Regulator::new(2000);
        for second in 0..100 {
            let last = 20 * second;
            assert_eq!(regulator.look(second as f64, last, last.saturating_sub(3)), None);
        }
        // Nothing to do for half a minute, then a few messages that came just before the look.
        for second in 100..130 {
            assert_eq!(regulator.look(second as f64, 1980, 1980), None);
        }
        assert_eq!(regulator.look(130.0, 1986, 1980), None);
        assert_eq!(regulator.look(131.0, 1986, 1986), None);
        // One a second for an hour, and ten at once.
        for second in 132..3732 {
            let last = second + 1855;
            assert_eq!(regulator.look(second as f64, last, last), None);
        }
        assert_eq!(regulator.look(3732.0, 5597, 5586), None);
        // A stream that was set back begins anew.
        assert_eq!(regulator.look(3733.0, 5, 0), None);
        let mut still = Regulator::new(2000);
        for second in 0..10 {
            assert_eq!(still.look(second as f64, 1000 * second, 0), None);
        }
    }
}
