//! Places for unauthenticated connections. A new connection always gets a place, because a full list closes its oldest
//! connection. An unauthenticated client can therefore not block others or exhaust threads and sockets.

use std::net::{IpAddr, Ipv4Addr, Shutdown, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A limited number of places for connections, with a limit per address.
#[derive(Clone)]
pub struct Places {
    max_places: usize,
    per_address: usize,
    connections: Arc<Mutex<Vec<Connection>>>,
}

struct Connection {
    number: u64,
    address: IpAddr,
    stream: TcpStream,
    is_active: bool,
}

/// A connection's place, which becomes free when this value is dropped.
pub struct Place {
    number: u64,
    places: Places,
}

impl Places {
    /// Creates `max_places` places, at most `per_address` for each address.
    pub fn new(max_places: usize, per_address: usize) -> Self {
        Self { max_places, per_address, connections: Arc::default() }
    }
    fn lock(&self) -> MutexGuard<'_, Vec<Connection>> {
        self.connections.lock().unwrap_or_else(PoisonError::into_inner)
    }
    /// Returns a place for a connection; `None` if the connection has already ended.
    ///
    /// If no place is free, closes another connection: of the same address if the address is at its limit, otherwise of
    /// the address with the most places. Closes silent connections first, then the oldest.
    pub fn enter(&self, stream: &TcpStream) -> Option<Place> {
        static NEXT_NUMBER: AtomicU64 = AtomicU64::new(0);
        let address = stream.peer_addr().ok()?.ip();
        let stream = stream.try_clone().ok()?;
        let number = NEXT_NUMBER.fetch_add(1, Ordering::SeqCst);
        let mut connections = self.lock();
        let count = |connections: &[Connection], address: IpAddr| {
            connections.iter().filter(|other| other.address == address).count()
        };
        while count(&connections, address) >= self.per_address {
            close_oldest(&mut connections, address);
        }
        while connections.len() >= self.max_places {
            let fullest = connections.iter().map(|other| other.address).max_by_key(|other| count(&connections, *other));
            close_oldest(&mut connections, fullest.unwrap_or(Ipv4Addr::LOCALHOST.into()));
        }
        connections.push(Connection { number, address, stream, is_active: false });
        Some(Place { number, places: self.clone() })
    }
}

fn close_oldest(connections: &mut Vec<Connection>, address: IpAddr) {
    let oldest =
        |is_active: bool| connections.iter().position(|other| other.address == address && other.is_active == is_active);
    // Callers pass only the address of an existing connection.
    let at = oldest(false).or_else(|| oldest(true)).unwrap_or(0);
    let _ = connections.remove(at).stream.shutdown(Shutdown::Both);
}

impl Place {
    /// Marks the connection as active because it has sent data, so that silent connections are closed first.
    pub fn mark_active(&self) {
        let mut connections = self.places.lock();
        connections.iter_mut().filter(|other| other.number == self.number).for_each(|own| own.is_active = true);
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
