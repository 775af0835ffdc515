//! Connects the emulated board's serial port to other programs, through a TCP port and, where the system has them, a
//! pseudo-terminal. Virtual time follows the wall clock as far as the emulator is fast enough.

use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use haptic_sim::door::turn_away;

/// Time that a second tool waits for the first to disconnect, so that one command can follow another directly.
const SECOND_TOOL_WAIT: Duration = Duration::from_millis(500);
/// Time for which a refused tool receives the replies to its request to disarm.
const GUEST_REPLY_TIME: Duration = Duration::from_secs(1);

type DisarmRequest = (Vec<u8>, TcpStream);

/// The other end of the board's serial port.
pub trait Outlet {
    /// Returns true if a program holds the port open.
    fn is_open(&mut self) -> bool;
    /// Returns the bytes that the program has written since the last call.
    fn read(&mut self) -> Vec<u8>;
    /// Sends bytes to the program. Bytes that the program does not accept are lost.
    fn write(&mut self, bytes: &[u8]);
}

/// A TCP port for one program at a time. A second program is refused, but its request to disarm is passed on.
#[derive(Debug)]
pub struct TcpOutlet {
    listener: TcpListener,
    stream: Option<TcpStream>,
    second_client: Option<(TcpStream, Instant)>,
    disarm_sender: Sender<DisarmRequest>,
    disarm_receiver: Receiver<DisarmRequest>,
    guests: Vec<(TcpStream, Instant)>,
}

impl TcpOutlet {
    /// Listens on `port` of this machine only. Port 0 selects any free port.
    /// Returns an error if the port is in use.
    pub fn listen(port: u16) -> io::Result<Self> {
        let listener = TcpListener::bind(("127.0.0.1", port))?;
        listener.set_nonblocking(true)?;
        let (disarm_sender, disarm_receiver) = channel();
        Ok(Self { listener, stream: None, second_client: None, disarm_sender, disarm_receiver, guests: Vec::new() })
    }

    /// Returns the port number.
    /// Returns an error if the socket is closed.
    pub fn port(&self) -> io::Result<u16> {
        Ok(self.listener.local_addr()?.port())
    }
}

impl Outlet for TcpOutlet {
    fn is_open(&mut self) -> bool {
        if self.second_client.is_none() {
            self.second_client = self.listener.accept().ok().map(|(stream, _)| (stream, Instant::now()));
        }
        match self.second_client.take() {
            Some((stream, _)) if self.stream.is_none() => {
                let usable = stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok();
                self.stream = usable.then_some(stream);
            }
            Some((stream, since)) if since.elapsed() > SECOND_TOOL_WAIT => {
                let disarm = self.disarm_sender.clone();
                if stream.set_nonblocking(false).is_ok() {
                    thread::spawn(move || {
                        if let Some(request) = turn_away(&stream) {
                            let _ = disarm.send((request, stream));
                        }
                    });
                }
            }
            second_client => self.second_client = second_client,
        }
        self.stream.is_some()
    }

    fn read(&mut self) -> Vec<u8> {
        if let Ok((request, guest)) = self.disarm_receiver.try_recv() {
            let _ = guest.set_write_timeout(Some(Duration::from_millis(100)));
            self.guests.push((guest, Instant::now()));
            // A zero ends any unfinished frame.
            return [vec![0], request].concat();
        }
        let mut bytes = vec![0; 4096];
        let Some(stream) = &mut self.stream else { return Vec::new() };
        match stream.read(&mut bytes) {
            Ok(count) if count > 0 => {
                bytes.truncate(count);
                return bytes;
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            _ => self.stream = None,
        }
        Vec::new()
    }

    fn write(&mut self, bytes: &[u8]) {
        self.guests.retain_mut(|(guest, since)| since.elapsed() < GUEST_REPLY_TIME && guest.write_all(bytes).is_ok());
        if let Some(stream) = &mut self.stream
            && stream.write_all(bytes).is_err_and(|error| error.kind() != io::ErrorKind::WouldBlock)
        {
            self.stream = None;
        }
    }
}

#[cfg(unix)]
pub use terminal::TerminalOutlet;

#[cfg(unix)]
mod terminal {
    use super::Outlet;
    use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
    use std::io;
    use std::os::fd::OwnedFd;

    /// A pseudo-terminal, which programs use like a serial port.
    #[derive(Debug)]
    pub struct TerminalOutlet {
        master: OwnedFd,
        /// Kept open so that the terminal does not hang up when a program closes it.
        _slave: OwnedFd,
        path: String,
    }

    impl TerminalOutlet {
        /// Opens a pseudo-terminal.
        /// Returns an error if the system has no pseudo-terminals or no free one.
        pub fn new() -> io::Result<Self> {
            let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
            grantpt(&master)?;
            unlockpt(&master)?;
            let path = ptsname(&master, Vec::new())?.to_string_lossy().into_owned();
            let slave = open(path.as_str(), OFlags::RDWR | OFlags::NOCTTY, Mode::empty())?;
            let mut settings = tcgetattr(&slave)?;
            settings.make_raw();
            tcsetattr(&slave, OptionalActions::Now, &settings)?;
            fcntl_setfl(&master, OFlags::NONBLOCK)?;
            Ok(Self { master, _slave: slave, path })
        }

        #[must_use]
        pub fn path(&self) -> &str {
            &self.path
        }
    }

    impl Outlet for TerminalOutlet {
        fn is_open(&mut self) -> bool {
            true
        }

        fn read(&mut self) -> Vec<u8> {
            let mut bytes = vec![0; 4096];
            let count = rustix::io::read(&self.master, &mut bytes).unwrap_or(0);
            bytes.truncate(count);
            bytes
        }

        fn write(&mut self, bytes: &[u8]) {
            // A terminal is full if no program reads. The bytes are lost then, as on a serial line.
            let _ = rustix::io::write(&self.master, bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_program_is_refused_and_the_first_continues() {
        let mut outlet = TcpOutlet::listen(0).expect("a free port");
        let port = outlet.port().expect("it listens");
        let mut first = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
        while !outlet.is_open() {}
        let mut second = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
        second.set_nonblocking(true).expect("a socket");
        let mut reply = [0; 64];
        let length = loop {
            assert!(outlet.is_open());
            match second.read(&mut reply) {
                Ok(length) => break length,
                Err(error) => assert_eq!(error.kind(), io::ErrorKind::WouldBlock),
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        assert!(length > 8 && reply[length - 1] == 0, "a complete frame: {:?}", &reply[..length]);
        first.write_all(b"still here").expect("the first is connected");
        let mut heard = Vec::new();
        while heard.len() < 10 {
            heard.extend(outlet.read());
        }
        assert_eq!(heard, b"still here");
        // When the first program disconnects, the next program gets the port.
        drop(first);
        let mut third = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
        third.write_all(b"!").expect("the third is connected");
        while {
            outlet.is_open();
            outlet.read()
        } != b"!"
        {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
