//! A simulated board that can be plugged in and unplugged.

use super::sim::Sim;
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread::spawn;

/// An address at which simulated boards are plugged in and unplugged.
pub struct Socket {
    /// Address for `--port`.
    pub address: String,
    board: Arc<Mutex<Option<Sim>>>,
}

impl Socket {
    pub fn empty() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("tcp:{}", listener.local_addr().unwrap());
        let board = Arc::new(Mutex::new(None::<Sim>));
        let plugged = Arc::clone(&board);
        spawn(move || {
            for tool in listener.incoming().map(Result::unwrap) {
                let port = plugged.lock().unwrap().as_ref().map(|sim| sim.port.replace("tcp:", ""));
                if let Some(Ok(board)) = port.map(TcpStream::connect) {
                    forward_bytes(tool.try_clone().unwrap(), board.try_clone().unwrap());
                    forward_bytes(board, tool);
                }
            }
        });
        Self { address, board }
    }

    pub fn plug(&self, arguments: &[&str]) {
        *self.board.lock().unwrap() = Some(Sim::start(arguments));
    }

    pub fn unplug(&self) {
        *self.board.lock().unwrap() = None;
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        self.unplug();
    }
}

/// Copies bytes until one end closes, then closes both.
fn forward_bytes(mut from: TcpStream, mut to: TcpStream) {
    let _ = to.set_nodelay(true);
    spawn(move || {
        let _ = std::io::copy(&mut from, &mut to);
        let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
    });
}
