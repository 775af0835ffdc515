//! The page's server: HTTP and WebSocket on one port of this computer.
//!
//! An unauthenticated connection gets one of a few places for a short time and loses the place to later connections; an
//! authenticated connection gets a place of another kind. A page uses bounded memory and takes turns with other pages.
//!
//! `GET /` is the page, `GET /live` its WebSocket. Only this computer can connect unless the address allows others, who
//! then need the token. Pages of other sites in the same browser are refused as well: the request must name this server
//! by its address (or `localhost`), and come from a page of this server.

use super::hub::{self, Hub, PageId};
use super::message::FromPage;
use haptic_host::link::should_retry;
use haptic_host::places::{Place, Places};
use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};
use std::thread;
use std::time::{Duration, Instant};
use tungstenite::handshake::machine::TryParse;
use tungstenite::handshake::server::{Request, create_response, write_response};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

/// The page, with style and scripts inserted where page.html names them.
static PAGE: LazyLock<String> = LazyLock::new(|| {
    let parts = [
        ("style.css", include_str!("page/style.css")),
        ("link.js", include_str!("page/link.js")),
        ("stage.js", include_str!("page/stage.js")),
        ("slow.js", include_str!("page/slow.js")),
        ("plane.js", include_str!("page/plane.js")),
        ("limits.js", include_str!("page/limits.js")),
        ("scope.js", include_str!("page/scope.js")),
        ("share.js", include_str!("page/share.js")),
    ];
    let page = include_str!("page/page.html").to_owned();
    parts.iter().fold(page, |page, (name, text)| page.replacen(&format!("/* {name} */\n"), text, 1))
});
/// Content security policy: the page may run its own scripts and connect to its own server, and nothing else.
const PAGE_POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
const MAX_HEAD_BYTES: usize = 8192;
/// Time limit for the head of a request; long, because browsers open connections before they use them. Silent
/// connections are closed first if places are short.
const HEAD_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum number of connections whose head has not been read, in total and from one address: a browser opens six.
const MAX_HANDSHAKES: (usize, usize) = (32, 8);
const MAX_MESSAGE_BYTES: usize = 16 * 1024;
/// Time for which a page's thread reads before it sends messages: 8 ms, half a picture.
const READ_TIMEOUT: Duration = Duration::from_millis(8);
/// Maximum number of messages that a page's thread reads in `READ_TIMEOUT`; further messages wait.
const MAX_MESSAGES_PER_READ: usize = 32;
/// Maximum number of unread bytes for a page: room for some pictures with sweeps and sound.
const MAX_UNREAD_BYTES: usize = 4 * 1024 * 1024;
/// Longest time for which a page may leave data unread.
const SEND_TIMEOUT: Duration = Duration::from_secs(2);
/// Maximum number of authenticated connections, pages included.
const MAX_CONNECTIONS: usize = 64;

/// The clients that can use a printed address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// All clients that can reach the requested address.
    Address,
    /// The server listens on all addresses, and the printed address is known to other computers.
    Others,
    /// The server listens on all addresses, and the address for other computers is not known.
    Unknown,
}

/// A port for browsers.
#[derive(Debug)]
pub struct PageListener {
    listener: TcpListener,
    token: Option<String>,
}

impl PageListener {
    /// Listens on an address. Other computers need a token, which is drawn at random here.
    pub fn open(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let token = if address.ip().is_loopback() { None } else { Some(token()?) };
        Ok(Self { listener, token })
    }

    /// Returns the address to open in a browser.
    pub fn url(&self) -> io::Result<String> {
        let mut address = self.listener.local_addr()?;
        if address.ip().is_unspecified() {
            // An unspecified address means all addresses; a browser cannot open it.
            address.set_ip(outward_address(address.ip()).unwrap_or(loopback_address(address.ip())));
        }
        let token = self.token.as_ref().map_or(String::new(), |token| format!("?token={token}"));
        Ok(format!("http://{address}/{token}"))
    }

    /// Returns the clients that can use [`Self::url`].
    pub fn reach(&self) -> io::Result<Reach> {
        let ip = self.listener.local_addr()?.ip();
        Ok(match ip.is_unspecified() {
            false => Reach::Address,
            true if outward_address(ip).is_some() => Reach::Others,
            true => Reach::Unknown,
        })
    }

    /// Serves pages on separate threads until the process ends.
    pub fn serve(self, hub: Hub) {
        let token = Arc::new(self.token);
        let open = Arc::new(AtomicUsize::new(0));
        let handshakes = Places::new(MAX_HANDSHAKES.0, MAX_HANDSHAKES.1);
        thread::spawn(move || {
            for stream in self.listener.incoming() {
                let Ok(stream) = stream else { continue };
                let Some(place) = handshakes.enter(&stream) else { continue };
                let (hub, token, open) = (hub.clone(), Arc::clone(&token), Arc::clone(&open));
                thread::spawn(move || {
                    // Ignores a failed connection, because the browser reports and repeats it.
                    let _ = handle_connection(stream, place, &hub, token.as_deref(), &open);
                });
            }
        });
    }
}

/// Returns the address of this computer for other computers: the source address of a route. Sends nothing.
fn outward_address(all: IpAddr) -> Option<IpAddr> {
    let target: IpAddr = match all {
        IpAddr::V4(_) => Ipv4Addr::new(192, 0, 2, 1).into(),
        IpAddr::V6(_) => Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1).into(),
    };
    let socket = UdpSocket::bind((all, 0)).ok()?;
    socket.connect((target, 9)).ok()?;
    let from = socket.local_addr().ok()?.ip();
    (!from.is_unspecified() && !from.is_loopback()).then_some(from)
}

fn loopback_address(all: IpAddr) -> IpAddr {
    if all.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() }
}

/// Returns a token of 128 random bits in hexadecimal.
pub(crate) fn token() -> io::Result<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Reads the head of a GET request; `None` for any other request, and for a head that is too long or too late. A
/// connection without a request is closed, because a browser would take a reply for the reply to its next request.
pub(crate) fn read_request(stream: &mut TcpStream) -> Option<Request> {
    let mut bytes = Vec::new();
    let request = try_read_request(stream, &mut bytes);
    if bytes.is_empty() {
        let _ = stream.shutdown(Shutdown::Both);
    }
    request
}

fn try_read_request(stream: &mut TcpStream, bytes: &mut Vec<u8>) -> Option<Request> {
    let began = Instant::now();
    while bytes.len() < MAX_HEAD_BYTES {
        let left = HEAD_TIMEOUT.checked_sub(began.elapsed()).filter(|left| !left.is_zero())?;
        stream.set_read_timeout(Some(left)).ok()?;
        let mut buffer = [0; 1024];
        let count = stream.read(&mut buffer).ok().filter(|count| *count > 0)?;
        bytes.extend(&buffer[..count]);
        match Request::try_parse(bytes) {
            // A WebSocket client sends nothing between its request and the reply; further bytes are refused.
            Ok(Some(_)) if bytes.ends_with(b"\r\n\r\n") => {
                return Request::try_parse(bytes).ok()?.map(|(_, read)| read);
            }
            Ok(None) => {}
            Ok(Some(_)) | Err(_) => return None,
        }
    }
    None
}

/// HTTP status and text of a refusal.
type Refusal = (&'static str, &'static str);

pub(crate) fn request_token(request: &Request) -> Option<&str> {
    request.uri().query().unwrap_or_default().split('&').find_map(|part| part.strip_prefix("token="))
}

/// Checks that a request comes from a page of this server, with the token if one is needed.
fn check_access(request: &Request, token: Option<&str>) -> Result<(), Refusal> {
    let header = |name: &str| request.headers().get(name).and_then(|value| value.to_str().ok());
    let host = header("host").unwrap_or_default();
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name).trim_start_matches('[').trim_end_matches(']');
    if name != "localhost" && name.parse::<IpAddr>().is_err() {
        return Err(("403 Forbidden", "open this page by the address that `haptic view` printed"));
    }
    if header("origin").is_some_and(|origin| origin != format!("http://{host}")) {
        return Err(("403 Forbidden", "this page belongs to another site"));
    }
    if token.is_some_and(|token| request_token(request) != Some(token)) {
        return Err(("403 Forbidden", "the token is missing or wrong: open the address that `haptic view` printed"));
    }
    Ok(())
}

fn handle_connection(
    mut stream: TcpStream,
    place: Place,
    hub: &Hub,
    token: Option<&str>,
    open: &AtomicUsize,
) -> tungstenite::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(SEND_TIMEOUT))?;
    let Some(request) = read_request(&mut stream) else {
        return send_refusal(&mut stream, ("400 Bad Request", "not a request that this server understands"));
    };
    if let Err(refusal) = check_access(&request, token) {
        return send_refusal(&mut stream, refusal);
    }
    drop(place);
    let result = match (open.fetch_add(1, Ordering::SeqCst) < MAX_CONNECTIONS, request.uri().path()) {
        (false, _) => send_refusal(&mut stream, ("503 Service Unavailable", "too many connections are open")),
        (true, "/") => send_page(&mut stream),
        (true, "/live") => serve_live(stream, &request, hub),
        (true, _) => send_refusal(&mut stream, ("404 Not Found", "nothing is here; the page is at /")),
    };
    open.fetch_sub(1, Ordering::SeqCst);
    result
}

fn send_page(stream: &mut TcpStream) -> tungstenite::Result<()> {
    write!(
        stream,
        "HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=utf-8\r\nContent-Length: {}\r\n\
         Content-Security-Policy: {PAGE_POLICY}\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
         Cache-Control: no-store\r\nConnection: close\r\n\r\n{}",
        PAGE.len(),
        *PAGE
    )?;
    Ok(())
}

fn send_refusal(stream: &mut TcpStream, (status, words): Refusal) -> tungstenite::Result<()> {
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\r\n\
         {words}\n",
        words.len() + 1
    )?;
    Ok(())
}

fn serve_live(mut stream: TcpStream, request: &Request, hub: &Hub) -> tungstenite::Result<()> {
    let Ok(response) = create_response(request) else {
        return send_refusal(&mut stream, ("400 Bad Request", "this address is a WebSocket; the page is at /"));
    };
    let Some(id) = hub.add_page() else {
        return send_refusal(&mut stream, ("503 Service Unavailable", "too many pages are open"));
    };
    let result = exchange_messages(stream, &response, hub, id);
    hub.remove_page(id);
    result
}

fn exchange_messages(
    mut stream: TcpStream,
    response: &tungstenite::handshake::server::Response,
    hub: &Hub,
    id: PageId,
) -> tungstenite::Result<()> {
    write_response(&mut stream, response)?;
    stream.set_read_timeout(Some(READ_TIMEOUT))?;
    let config = WebSocketConfig::default()
        .max_message_size(Some(MAX_MESSAGE_BYTES))
        .max_frame_size(Some(MAX_MESSAGE_BYTES))
        .max_write_buffer_size(MAX_UNREAD_BYTES);
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    loop {
        let began = Instant::now();
        for count in 1..=MAX_MESSAGES_PER_READ {
            match socket.read() {
                Ok(Message::Text(text)) => hub.queue_incoming(id, FromPage::parse(&text)),
                Ok(Message::Binary(_)) => {
                    hub.queue_incoming(id, Err("not a message of this page: it is binary".into()))
                }
                Ok(Message::Close(_)) => return Ok(()),
                Ok(_) => {}
                Err(tungstenite::Error::Io(error)) if should_retry(&error) => break,
                Err(error) => return Err(error),
            }
            match READ_TIMEOUT.checked_sub(began.elapsed()) {
                // After the maximum number of messages, the rest waits for the page's next turn.
                Some(left) if count == MAX_MESSAGES_PER_READ => thread::sleep(left),
                Some(_) => {}
                None => break,
            }
        }
        for message in hub.take_outbox(id).messages() {
            socket.write(match message {
                hub::Message::Text(text) => Message::text(text),
                hub::Message::Bytes(bytes) => Message::binary(bytes),
            })?;
        }
        socket.flush()?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(head: &str) -> Request {
        Request::try_parse(head.as_bytes()).unwrap().unwrap().1
    }

    #[test]
    fn only_pages_of_this_server_are_admitted() {
        let is_admitted = |host: &str, origin: &str| {
            let origin = if origin.is_empty() { String::new() } else { format!("Origin: {origin}\r\n") };
            check_access(&request(&format!("GET /live HTTP/1.1\r\nHost: {host}\r\n{origin}\r\n")), None).is_ok()
        };
        assert!(is_admitted("127.0.0.1:7720", "") && is_admitted("localhost:7720", "http://localhost:7720"));
        assert!(is_admitted("[::1]:7720", "http://[::1]:7720"));
        // A foreign name that resolves to this computer, and a page of another site.
        assert!(!is_admitted("evil.example:7720", "") && !is_admitted("", ""));
        assert!(!is_admitted("127.0.0.1:7720", "http://evil.example") && !is_admitted("127.0.0.1:7720", "null"));
        assert!(!is_admitted("127.0.0.1:7720", "http://127.0.0.1:7721"));
    }

    #[test]
    fn requests_need_the_token_if_there_is_one() {
        let is_admitted = |query: &str| {
            check_access(&request(&format!("GET /{query} HTTP/1.1\r\nHost: 10.0.0.1\r\n\r\n")), Some("abc")).is_ok()
        };
        assert!(is_admitted("?token=abc") && is_admitted("?a=b&token=abc"));
        assert!(
            !is_admitted("") && !is_admitted("?token=") && !is_admitted("?token=abcd") && !is_admitted("?nottoken=abc")
        );
        assert_eq!(token().unwrap().len(), 32);
        assert_ne!(token().unwrap(), token().unwrap());
    }

    #[test]
    fn the_page_loads_nothing_from_elsewhere() {
        assert!(!PAGE.contains(".js */") && !PAGE.contains(".css */"));
        // The XML namespace of SVG is not an address.
        let page = PAGE.replace("http://www.w3.org/2000/svg", "");
        assert!(!page.contains("https://") && !page.contains("http://www") && !page.contains("src="));
    }

    #[test]
    fn lessons_use_shipped_files() {
        let devices = concat!(env!("CARGO_MANIFEST_DIR"), "/../../devices/");
        let links = PAGE.split("\"device=").skip(1).filter_map(|rest| rest.split(['&', '"']).next());
        // The demo needs no file.
        let named: Vec<&str> = links.filter(|name| !["", "coupled-five-bar"].contains(name)).collect();
        assert!(named.len() >= 3, "{named:?}");
        for name in named {
            let (device, _) = name.split_once('/').unwrap_or_else(|| panic!("{name}"));
            for path in [format!("{devices}{device}.toml"), format!("{devices}scenes/{name}.toml")] {
                assert!(std::fs::exists(&path).unwrap(), "{path}");
            }
        }
    }

    #[test]
    fn feed_forward_has_the_same_colours_as_in_pictures() {
        use crate::plot::colour::{FULL_COLOUR, OFF_COLOUR, WASHOUT_COLOUR};
        // On a dark background the hues are the same, but lighter.
        for [off, full, washout] in [[OFF_COLOUR, FULL_COLOUR, WASHOUT_COLOUR], ["#56B4E9", "#FF9155", "#3ECDA3"]] {
            assert!(PAGE.contains(&format!("--off: {off}; --full: {full}; --washout: {washout};")), "{off}");
        }
    }

    /// WCAG 2.2, level AA: 4.5 for text, 3 for lines and symbols.
    #[test]
    fn text_and_lines_have_enough_contrast() {
        let luminance = |colour: &str| {
            let [r, g, b] = [1, 3, 5].map(|at| {
                let share = f64::from(u8::from_str_radix(&colour[at..at + 2], 16).unwrap()) / 255.0;
                if share <= 0.04045 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
            });
            0.05 + 0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let blocks: Vec<&str> = PAGE.split("--back: ").skip(1).map(|rest| rest.split('}').next().unwrap()).collect();
        assert_eq!(blocks.len(), 2, "light and dark");
        for block in blocks {
            let of = |name: &str| luminance(block.split(&format!("--{name}: ")).nth(1).unwrap());
            let check = |name: &str, ground: &str, min: f64| {
                let contrast = of(name) / of(ground);
                let contrast = contrast.max(1.0 / contrast);
                assert!(contrast >= min, "{name} on {ground}: {contrast:.2} in {block}");
            };
            for words in ["ink", "dim", "bad", "hand", "force", "off-name", "full-name", "washout-name"] {
                check(words, "card", 4.5);
            }
            for words in ["ink", "dim"] {
                check(words, "wall", 4.5);
                check(words, "soft", 4.5);
            }
            for line in ["off", "full", "washout", "spring", "hatch", "link"] {
                check(line, "card", 3.0);
            }
            for line in ["spring", "hatch", "link", "hand", "force"] {
                check(line, "wall", 3.0);
            }
        }
    }
}
