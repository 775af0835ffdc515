//! Byte streams to a board: a serial port (or pseudo-terminal) and TCP.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// A byte stream with a clock. The clock of a simulated board in this process is simulated time, so that timeouts mean
/// the same on simulated and real boards.
pub trait Wire: Send {
    /// Sends all of `bytes`.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Waits at most `timeout` for bytes and returns their number, which may be 0. Returns an error if the wire is
    /// gone.
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize>;
    /// Returns the time since a fixed instant.
    fn now(&self) -> Duration;
    /// Returns the extra time that a reply may take: zero, except for a board that is a process on a computer that may
    /// be busy.
    fn slack(&self) -> Duration {
        Duration::ZERO
    }
    /// Draws a random number, which almost certainly differs from earlier numbers in this and other processes.
    fn draw(&mut self) -> u32 {
        use std::hash::{BuildHasher, RandomState};
        RandomState::new().hash_one(0) as u32
    }
}

/// Slack of a simulated or emulated board in its own process.
const PROCESS_SLACK: Duration = Duration::from_secs(10);

/// Time after which a wire that accepts no bytes counts as lost. A flash erase stalls a board for 0.5 s (STM32F405 data
/// sheet, table 40: 16 KB sector).
const SEND_TIMEOUT: Duration = Duration::from_secs(3);

/// Shortest timeout for the operating system, because sockets treat zero as infinite.
const MIN_TIMEOUT: Duration = Duration::from_millis(1);

/// Returns true if a read should be repeated: it timed out, or a signal interrupted it.
pub fn should_retry(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

fn closed_error(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::UnexpectedEof, what)
}

/// A serial port, held exclusively.
pub struct SerialWire {
    port: Box<dyn serialport::SerialPort>,
    start: Instant,
    slack: Duration,
}

impl SerialWire {
    /// Opens the port at `path`; a USB serial port ignores the baud rate.
    pub fn open(path: &str) -> Result<Self, serialport::Error> {
        // Clears the exclusive mode of a pseudo-terminal for `haptic disarm`; the lock still refuses other tools.
        let process = is_pseudo_terminal(path);
        #[cfg(unix)]
        let terminal = if process { open_terminal(path).ok() } else { None };
        let port = serialport::new(path, 115_200).timeout(SEND_TIMEOUT).dtr_on_open(true).open()?;
        #[cfg(unix)]
        if let Some(terminal) = terminal {
            let _ = rustix::termios::ioctl_tiocnxcl(terminal);
        }
        Ok(Self { port, start: Instant::now(), slack: if process { PROCESS_SLACK } else { Duration::ZERO } })
    }
}

impl Wire for SerialWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.port.set_timeout(SEND_TIMEOUT)?;
        // Does not flush, because a flush waits forever for a board that does not read.
        self.port.write_all(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.port.set_timeout(timeout.max(MIN_TIMEOUT))?;
        match self.port.read(buffer) {
            Ok(0) => Err(closed_error("the port has closed")),
            Ok(count) => Ok(count),
            Err(error) if should_retry(&error) => Ok(0),
            Err(error) => Err(error),
        }
    }

    fn now(&self) -> Duration {
        self.start.elapsed()
    }
    fn slack(&self) -> Duration {
        self.slack
    }
}

/// Returns true if the path is a pseudo-terminal, the port of a simulated or emulated board.
pub(super) fn is_pseudo_terminal(path: &str) -> bool {
    std::fs::canonicalize(path).is_ok_and(|path| path.starts_with("/dev/pts") || path.starts_with("/dev/ttys"))
}

#[cfg(unix)]
fn open_terminal(path: &str) -> io::Result<std::fs::File> {
    use rustix::fs::{Mode, OFlags};
    Ok(rustix::fs::open(path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?.into())
}

/// A pseudo-terminal that another tool also holds.
#[cfg(unix)]
pub(super) struct SharedWire {
    terminal: std::fs::File,
    start: Instant,
}

#[cfg(unix)]
impl SharedWire {
    pub(super) fn open(path: &str) -> io::Result<Self> {
        Ok(Self { terminal: open_terminal(path)?, start: Instant::now() })
    }
}

#[cfg(unix)]
impl Wire for SharedWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.terminal.write_all(bytes)
    }
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        use rustix::event::{PollFd, PollFlags, Timespec, poll};
        let limit = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: timeout.subsec_nanos().into() };
        let ready = poll(&mut [PollFd::new(&self.terminal, PollFlags::IN)], Some(&limit))?;
        if ready == 0 { Ok(0) } else { self.terminal.read(buffer) }
    }

    fn now(&self) -> Duration {
        self.start.elapsed()
    }
}

/// A TCP connection.
pub struct TcpWire {
    stream: TcpStream,
    start: Instant,
}

impl TcpWire {
    /// Creates the wire of an open connection.
    pub fn new(stream: TcpStream) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(SEND_TIMEOUT))?;
        Ok(Self { stream, start: Instant::now() })
    }
}

impl Wire for TcpWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.stream.write_all(bytes)
    }
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(timeout.max(MIN_TIMEOUT)))?;
        match self.stream.read(buffer) {
            Ok(0) => Err(closed_error("the connection was closed")),
            Ok(count) => Ok(count),
            Err(error) if should_retry(&error) => Ok(0),
            Err(error) => Err(error),
        }
    }

    fn now(&self) -> Duration {
        self.start.elapsed()
    }
    fn slack(&self) -> Duration {
        PROCESS_SLACK
    }
}
