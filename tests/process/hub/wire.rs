//! A network between two processes, which can be cut: connections that close, or that carry nothing for a while.

use rand::{Rng, RngExt};
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Time between two looks at the state of the wire.
const LOOK: Duration = Duration::from_millis(10);
/// Longest cut \[ms\].
const LONGEST_MS: u64 = 4000;

/// Behaviour of a network that is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Cut {
    /// Connections close, and new ones are closed at once.
    Closed,
    /// Nothing passes; what was under way arrives afterwards.
    Silent,
    /// Nothing passes, and afterwards every connection is lost with what was under way.
    Lost,
}

#[derive(Debug, Default)]
struct State {
    cut: Option<(Cut, Instant)>,
    /// Number of times at which all connections were lost.
    losses: u32,
    /// Number of connections' ways that are open.
    open: u32,
    /// True if a connection met the present cut, and the number of cuts that one met.
    is_met: bool,
    met: u32,
    is_over: bool,
}

/// A port of its own that leads to another one of this machine.
pub struct Wire {
    pub port: u16,
    state: Arc<Mutex<State>>,
}

impl State {
    /// Returns the cut that lasts, if any.
    fn look(&mut self) -> Option<Cut> {
        let (cut, until) = self.cut?;
        if Instant::now() < until {
            return Some(cut);
        }
        self.cut = None;
        self.losses += u32::from(cut == Cut::Lost);
        None
    }

    /// Says if a connection that began after so many losses goes on; `None` if it is lost.
    fn goes_on(&mut self, born: u32) -> Option<bool> {
        let cut = self.look();
        let is_lost = self.losses != born;
        if (is_lost || cut.is_some()) && !self.is_met {
            self.is_met = true;
            self.met += 1;
        }
        (!is_lost && !self.is_over).then_some(cut.is_none())
    }
}

impl Wire {
    pub fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let wire = Self {
            port: listener.local_addr().unwrap().port(),
            state: Arc::default(),
        };
        let state = Arc::clone(&wire.state);
        thread::spawn(move || serve(&listener, port, &state));
        wire
    }

    /// True if a connection is open.
    pub fn is_used(&self) -> bool {
        self.state.lock().unwrap().open > 0
    }

    /// Cuts it in a random way for a random time; a cut that lasts goes on as this one.
    pub fn cut(&self, generator: &mut impl Rng) {
        let cut = [Cut::Closed, Cut::Silent, Cut::Lost][generator.random_range(0..3)];
        let lasts = Duration::from_millis(generator.random_range(50..LONGEST_MS));
        let mut state = self.state.lock().unwrap();
        state.losses += u32::from(cut == Cut::Closed);
        state.is_met = false;
        state.cut = Some((cut, Instant::now() + lasts));
    }

    /// Number of cuts that a connection met.
    pub fn met(&self) -> u32 {
        self.state.lock().unwrap().met
    }

    /// Waits until it is whole again.
    pub fn wait(&self) {
        while self.state.lock().unwrap().look().is_some() {
            thread::sleep(LOOK);
        }
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.state.lock().unwrap().is_over = true;
    }
}

/// Takes connections; those that come in a silent time wait, as if their first packet were lost.
fn serve(listener: &TcpListener, port: u16, state: &Arc<Mutex<State>>) {
    loop {
        let (cut, is_over, born) = {
            let mut state = state.lock().unwrap();
            (state.look(), state.is_over, state.losses)
        };
        if is_over {
            return;
        }
        let taken = match cut {
            Some(Cut::Silent | Cut::Lost) => None,
            Some(Cut::Closed) => {
                drop(listener.accept());
                None
            }
            None => listener.accept().ok(),
        };
        let Some((client, _)) = taken else {
            thread::sleep(LOOK);
            continue;
        };
        let Ok(server) = TcpStream::connect(("127.0.0.1", port)) else {
            continue;
        };
        for stream in [&client, &server] {
            stream.set_nonblocking(false).unwrap();
            stream.set_nodelay(true).unwrap();
            stream.set_read_timeout(Some(LOOK)).unwrap();
        }
        let back = (server.try_clone().unwrap(), client.try_clone().unwrap());
        for (from, to) in [(client, server), back] {
            let state = Arc::clone(state);
            thread::spawn(move || {
                state.lock().unwrap().open += 1;
                carry(&from, &to, &state, born);
                state.lock().unwrap().open -= 1;
                let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
            });
        }
    }
}

/// Carries bytes one way until the connection ends or is lost.
fn carry(mut from: &TcpStream, mut to: &TcpStream, state: &Mutex<State>, born: u32) {
    let mut bytes = vec![0; 1 << 16];
    loop {
        let count = match from.read(&mut bytes) {
            Ok(0) => return,
            Ok(count) => count,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => 0,
            Err(_) => return,
        };
        loop {
            match state.lock().unwrap().goes_on(born) {
                None => return,
                Some(true) => break,
                Some(false) => {}
            }
            thread::sleep(LOOK);
        }
        if to.write_all(&bytes[..count]).is_err() {
            return;
        }
    }
}
