//! Places for connections that have not yet shown whose they are. A newcomer always gets one: if all are taken, the
//! connection that has had its own the longest is closed, so that strangers keep no one out and cost a bounded number
//! of threads and sockets.

use std::net::{IpAddr, Ipv4Addr, Shutdown, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A number of places, of which each address has a part.
#[derive(Clone)]
pub struct Places {
    most: usize,
    per_address: usize,
    taken: Arc<Mutex<Vec<Taken>>>,
}

struct Taken {
    number: u64,
    address: IpAddr,
    stream: TcpStream,
    spoke: bool,
}

/// A connection's place, given back when it is dropped.
pub struct Place {
    number: u64,
    places: Places,
}

impl Places {
    /// So many places, and at most so many of them for one address.
    pub fn new(most: usize, per_address: usize) -> Self {
        Self { most, per_address, taken: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Taken>> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns a place for a connection. If none is free, another connection loses its own: one of the same address if
    /// that has its part, otherwise one of the address that has most. Those that have said nothing go first, then the
    /// oldest.
    ///
    /// `None` for a connection that has gone already.
    pub fn enter(&self, stream: &TcpStream) -> Option<Place> {
        static NUMBERS: AtomicU64 = AtomicU64::new(0);
        let address = stream.peer_addr().ok()?.ip();
        let stream = stream.try_clone().ok()?;
        let number = NUMBERS.fetch_add(1, Ordering::SeqCst);
        let mut taken = self.lock();
        let of = |taken: &[Taken], address: IpAddr| taken.iter().filter(|other| other.address == address).count();
        while of(&taken, address) >= self.per_address {
            close_one(&mut taken, address);
        }
        while taken.len() >= self.most {
            let fullest = taken.iter().map(|other| other.address).max_by_key(|other| of(&taken, *other));
            close_one(&mut taken, fullest.unwrap_or(Ipv4Addr::LOCALHOST.into()));
        }
        taken.push(Taken { number, address, stream, spoke: false });
        Some(Place { number, places: self.clone() })
    }
}

fn close_one(taken: &mut Vec<Taken>, address: IpAddr) {
    let of = |spoke: bool| taken.iter().position(|other| other.address == address && other.spoke == spoke);
    // Whose turn it is is there: the address was counted.
    let at = of(false).or_else(|| of(true)).unwrap_or(0);
    let _ = taken.remove(at).stream.shutdown(Shutdown::Both);
}

impl Place {
    /// The connection has said something: it goes after those that have not.
    pub fn spoke(&self) {
        let mut taken = self.places.lock();
        taken.iter_mut().filter(|other| other.number == self.number).for_each(|own| own.spoke = true);
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

    /// A connection: its own end, and the one that is let in.
    fn from(listener: &TcpListener) -> (TcpStream, TcpStream) {
        let there = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        (there, listener.accept().unwrap().0)
    }

    fn is_closed(mut there: &TcpStream) -> bool {
        there.set_nonblocking(true).unwrap();
        there.read(&mut [0]).is_ok_and(|count| count == 0)
    }

    #[test]
    fn whoever_comes_gets_a_place_and_who_has_said_nothing_for_longest_goes() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let places = Places::new(3, 3);
        let come: Vec<_> = (0..3).map(|_| from(&listener)).collect();
        let mut seats: Vec<_> = come.iter().map(|(_, here)| places.enter(here).unwrap()).collect();
        seats[0].spoke();
        for (round, gone) in [1, 2].into_iter().enumerate() {
            let (_, here) = from(&listener);
            let seat = places.enter(&here).unwrap();
            seat.spoke();
            seats.push(seat);
            let closed: Vec<bool> = come.iter().map(|(there, _)| is_closed(there)).collect();
            assert!(closed[gone] && !closed[0], "round {round}: {closed:?}");
        }
        // When all have spoken, the oldest goes.
        let (_, here) = from(&listener);
        seats.push(places.enter(&here).unwrap());
        assert!(is_closed(&come[0].0));
        assert_eq!(places.lock().len(), 3);
        drop(seats);
        assert_eq!(places.lock().len(), 0);
    }

    #[test]
    fn an_address_has_its_part_of_the_places_and_leaves_the_rest_to_others() {
        let places = Places::new(4, 3);
        let [crowd, other] = ["127.0.0.1:0", "127.0.0.1:0"].map(|address| TcpListener::bind(address).unwrap());
        let many: Vec<_> = (0..10).map(|_| from(&crowd)).collect();
        let seats: Vec<_> = many.iter().map(|(_, here)| places.enter(here).unwrap()).collect();
        assert_eq!(places.lock().len(), 3);
        let (_there, here) = from(&other);
        let seat = places.enter(&here).unwrap();
        // As if it had another address.
        places
            .lock()
            .iter_mut()
            .filter(|own| own.number == seat.number)
            .for_each(|own| own.address = [10, 0, 0, 1].into());
        let (_late, here) = from(&crowd);
        let _seat = places.enter(&here).unwrap();
        assert_eq!(places.lock().len(), 4);
        assert!(places.lock().iter().any(|own| own.number == seat.number));
        drop(seats);
    }
}
