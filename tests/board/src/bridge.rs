//! The emulated board for other programs: its serial port as a TCP port and, where the system has them, a pseudo-terminal.
//!
//! Virtual time follows the wall clock, as far as the emulator is fast enough.

use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream};

/// A program's end of the board's serial port.
pub trait Outlet {
    /// Whether a program holds the port open.
    fn open(&mut self) -> bool;
    /// What the program has written since the last call.
    fn read(&mut self) -> Vec<u8>;
    /// Hands bytes to the program; what it does not take is lost.
    fn write(&mut self, bytes: &[u8]);
}

/// A TCP port that one program at a time connects to.
#[derive(Debug)]
pub struct TcpOutlet {
    listener: TcpListener,
    stream: Option<TcpStream>,
}

impl TcpOutlet {
    /// Listens on `port` of this machine alone; 0 takes any free port.
    ///
    /// # Errors
    ///
    /// A port that is taken.
    pub fn listen(port: u16) -> io::Result<Self> {
        let listener = TcpListener::bind(("127.0.0.1", port))?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, stream: None })
    }

    /// The port it listens on.
    ///
    /// # Errors
    ///
    /// A socket that has gone.
    pub fn port(&self) -> io::Result<u16> {
        Ok(self.listener.local_addr()?.port())
    }
}

impl Outlet for TcpOutlet {
    fn open(&mut self) -> bool {
        if self.stream.is_none()
            && let Ok((stream, _)) = self.listener.accept()
            && stream.set_nonblocking(true).is_ok()
            && stream.set_nodelay(true).is_ok()
        {
            self.stream = Some(stream);
        }
        self.stream.is_some()
    }

    fn read(&mut self) -> Vec<u8> {
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

    /// A pseudo-terminal, which looks like a serial port to a program.
    #[derive(Debug)]
    pub struct TerminalOutlet {
        master: OwnedFd,
        /// Held open, so that a program that leaves does not hang the terminal up.
        _slave: OwnedFd,
        path: String,
    }

    impl TerminalOutlet {
        /// Makes a terminal.
        ///
        /// # Errors
        ///
        /// A system without pseudo-terminals, or with none left.
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

        /// The device file a program opens.
        #[must_use]
        pub fn path(&self) -> &str {
            &self.path
        }
    }

    impl Outlet for TerminalOutlet {
        fn open(&mut self) -> bool {
            true
        }

        fn read(&mut self) -> Vec<u8> {
            let mut bytes = vec![0; 4096];
            let count = rustix::io::read(&self.master, &mut bytes).unwrap_or(0);
            bytes.truncate(count);
            bytes
        }

        fn write(&mut self, bytes: &[u8]) {
            // A full terminal means that nobody reads: the bytes go, as on a serial line.
            let _ = rustix::io::write(&self.master, bytes);
        }
    }
}
