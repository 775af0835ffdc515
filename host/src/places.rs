//! Places for unauthenticated connections. A new connection always gets a place: if all are taken, the oldest
//! connection is closed. An unauthenticated client can therefore not block others, and all use a bounded number of threads and
//! sockets.

use std::net::{IpAddr, Ipv4Addr, Shutdown, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A number of places, with a limit per address.
#[derive(Clone)]
pub struct Places {
    most: usize,
    per_address: usize,
    taken: Arc<Mutex<Vec<Connection>>>,
}

struct Connection {
    number: u64,
    address: IpAddr,
    stream: TcpStream,
    is_active: bool,
}

/// A connection's place, freed when it is dropped.
pub struct Place {
    number: u64,
    places: Places,
}

impl Places {
    /// Creates `most` places, at most `per_address` for each address.
    pub fn new(most: usize, per_address: usize) -> Self {
        Self { most, per_address, taken: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Connection>> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns a place for a connection; `None` if the connection has already ended.
    ///
    /// If no place is free, another connection is closed: one from the same address if that address is at its limit,
    /// otherwise one from the address with the most places. Silent connections are closed first, then the oldest.
    pub fn enter(&self, stream: &TcpStream) -> Option<Place> {
        static NUMBERS: AtomicU64 = AtomicU64::new(0);
        let address = stream.peer_addr().ok()?.ip();
        let stream = stream.try_clone().ok()?;
        let number = NUMBERS.fetch_add(1, Ordering::SeqCst);
        let mut taken = self.lock();
        let count =
            |taken: &[Connection], address: IpAddr| taken.iter().filter(|other| other.address == address).count();
        while count(&taken, address) >= self.per_address {
            close_oldest(&mut taken, address);
        }
        while taken.len() >= self.most {
            let fullest = taken.iter().map(|other| other.address).max_by_key(|other| count(&taken, *other));
            close_oldest(&mut taken, fullest.unwrap_or(Ipv4Addr::LOCALHOST.into()));
        }
        taken.push(Connection { number, address, stream, is_active: false });
        Some(Place { number, places: self.clone() })
    }
}

fn close_oldest(taken: &mut Vec<Connection>, address: IpAddr) {
    let oldest =
        |is_active: bool| taken.iter().position(|other| other.address == address && other.is_active == is_active);
    // The index is valid, because the caller has counted this address.
    let at = oldest(false).or_else(|| oldest(true)).unwrap_or(0);
    let _ = taken.remove(at).stream.shutdown(Shutdown::Both);
}

impl Place {
    /// Marks the connection as having sent data: it is closed after the silent ones.
    pub fn mark_active(&self) {
        let mut taken = self.places.lock();
        taken.iter_mut().filter(|other| other.number == self.number).for_each(|own| own.is_active = true);
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.places.lock().retain(|other| other.number != self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::net::TcpListener;

    /// Connects to `listener`; returns the client's end and the server's end.
    fn connect(listener: &TcpListener) -> (TcpStream, TcpStream) {
        let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        (client, listener.accept().unwrap().0)
    }

    fn is_closed(mut client: &TcpStream) -> bool {
        client.set_nonblocking(true).unwrap();
        client.read(&mut [0]).is_ok_and(|count| count == 0)
    }

    #[test]
    fn a_new_connection_replaces_the_longest_silent_connection() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let places = Places::new(3, 3);
        let connections: Vec<_> = (0..3).map(|_| connect(&listener)).collect();
        let mut seats: Vec<_> = connections.iter().map(|(_, server)| places.enter(server).unwrap()).collect();
        seats[0].mark_active();
        for (round, gone) in [1, 2].into_iter().enumerate() {
            let (_, server) = connect(&listener);
            let seat = places.enter(&server).unwrap();
            seat.mark_active();
            seats.push(seat);
            let closed: Vec<bool> = connections.iter().map(|(client, _)| is_closed(client)).collect();
            assert!(closed[gone] && !closed[0], "round {round}: {closed:?}");
        }
        // When all have sent data, the oldest is closed.
        let (_, server) = connect(&listener);
        seats.push(places.enter(&server).unwrap());
        assert!(is_closed(&connections[0].0));
        assert_eq!(places.lock().len(), 3);
        drop(seats);
        assert_eq!(places.lock().len(), 0);
    }

    #[test]
    fn an_address_gets_only_its_share_of_places() {
        let places = Places::new(4, 3);
        let [crowd, other] = ["127.0.0.1:0", "127.0.0.1:0"].map(|address| TcpListener::bind(address).unwrap());
        let many: Vec<_> = (0..10).map(|_| connect(&crowd)).collect();
        let seats: Vec<_> = many.iter().map(|(_, server)| places.enter(server).unwrap()).collect();
        assert_eq!(places.lock().len(), 3);
        let (_client, server) = connect(&other);
        let seat = places.enter(&server).unwrap();
        // Gives the connection another address.
        places
            .lock()
            .iter_mut()
            .filter(|own| own.number == seat.number)
            .for_each(|own| own.address = [10, 0, 0, 1].into());
        let (_late, server) = connect(&crowd);
        let _seat = places.enter(&server).unwrap();
        assert_eq!(places.lock().len(), 4);
        assert!(places.lock().iter().any(|own| own.number == seat.number));
        drop(seats);
    }
}
