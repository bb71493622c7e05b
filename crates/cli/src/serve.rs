//! A small web server that shows one page to browsers on this computer.
//!
//! In: a page of HTML and its content policy. Out: responses to `GET` and `HEAD` (HTTP/1.1, RFC 9112) on a
//! port of the loopback address, which other computers cannot reach.
//!
//! Other users and web sites can reach the port, so a request gets the page only if
//! - its address contains the random token of this run,
//! - it names this computer as its host, which stops web sites that point their own name at this address
//!   (DNS rebinding), and
//! - on Linux, its connection does not belong to another user ([`owner`]).
//!
//! One thread serves all connections without blocking. Silent and slow clients cannot delay others: their
//! number and their time are limited ([`Limits`]), and the oldest waiting connection makes room for a new
//! one.
//!
//! Not guaranteed: connections are not reused; each response closes its connection.

mod connection;
mod owner;
mod request;
mod response;
mod token;

use connection::{Connection, Step};
use planish::{Error, Result};
pub use response::ServedPage;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::time::{Duration, Instant};
use token::Token;

/// Shortest and longest pause between two rounds over the connections. Pauses double while nothing happens: 1
/// ms keeps transfers fast, and 30 ms is too short to notice and leaves the processor idle.
const PAUSES: [Duration; 2] = [Duration::from_millis(1), Duration::from_millis(30)];
/// Time for which the port may refuse new connections, for example because the process has too many open
/// files.
const MAX_ACCEPT_FAILURE: Duration = Duration::from_secs(10);

/// Limits that keep clients from delaying others or filling the memory.
#[derive(Debug, Clone, Copy)]
struct Limits {
    /// Maximum number of open connections. A browser opens at most six to one host.
    connections: usize,
    /// Maximum size of the request line and the header fields, in bytes. Browsers send about 1 kB.
    header_bytes: usize,
    /// Time from the connection to the end of the header.
    header_time: Duration,
    /// Time for a response: this, and one second for every [`Limits::bytes_per_second`].
    response_time: Duration,
    /// Lowest mean speed of a transfer, in bytes per second.
    bytes_per_second: usize,
    /// Time for the client to close the connection after the response.
    close_time: Duration,
    /// Time for unfinished transfers of the page after Ctrl-C.
    stop_time: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 64,
            header_bytes: 16 * 1024,
            header_time: Duration::from_secs(5),
            response_time: Duration::from_secs(10),
            bytes_per_second: 64 * 1024,
            close_time: Duration::from_secs(2),
            stop_time: Duration::from_secs(1),
        }
    }
}

/// A server for one page.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    token: Token,
    limits: Limits,
}

/// The properties of the server that its connections need.
struct Site<'a> {
    page: &'a ServedPage<'a>,
    token: &'a Token,
    address: SocketAddr,
    limits: Limits,
}

impl Server {
    /// Binds a port of the loopback address; without `port`, a free one.
    ///
    /// # Errors
    /// `Io` if the port is in use, or if the operating system supplies no random numbers.
    pub fn on(port: Option<u16>) -> Result<Self> {
        let token = Token::random()?;
        let wanted = SocketAddr::from((Ipv4Addr::LOCALHOST, port.unwrap_or(0)));
        let made = TcpListener::bind(wanted).and_then(|listener| {
            // `accept` must not block: the loop in `serve` also advances connections and looks at `stop`.
            listener.set_nonblocking(true)?;
            let address = listener.local_addr()?;
            Ok(Self { listener, address, token, limits: Limits::default() })
        });
        made.map_err(|e| {
            Error::io(match port {
                Some(port) => format!(
                    "port {port} could not be opened: another program may use it; omit --port to use a \
                     free port"
                ),
                None => "no free port could be opened".to_owned(),
            })
            .with_source(e)
        })
    }

    /// The address of the page. It contains the token, so only people who may see the page should see it.
    pub fn url(&self) -> String {
        format!("http://{}/{}", self.address, self.token.text())
    }

    /// Answers requests until `stop` returns true; returns the number of requests that got the page.
    ///
    /// After `stop`, no connection is accepted, and unfinished transfers of the page have a second to end.
    ///
    /// # Errors
    /// `Io` if the port is lost.
    pub fn serve(self, page: &ServedPage<'_>, stop: impl Fn() -> bool) -> Result<usize> {
        let Self { listener, address, token, limits } = self;
        let site = Site { page, token: &token, address, limits };
        let mut pool = Pool { site: &site, connections: Vec::new(), served: 0 };
        let mut failing_since = None;
        let mut pause = PAUSES[0];
        while !stop() {
            let mut is_active = pool.advance(Instant::now());
            match pool.accept(&listener) {
                Ok(accepted) => {
                    is_active |= accepted > 0;
                    failing_since = None;
                }
                // Errors such as too many open files of the process or the system can pass.
                Err(e) => {
                    if failing_since.get_or_insert_with(Instant::now).elapsed() > MAX_ACCEPT_FAILURE {
                        return Err(Error::io("the page can no longer be served").with_source(e));
                    }
                }
            }
            pause = if is_active { PAUSES[0] } else { PAUSES[1].min(2 * pause) };
            std::thread::sleep(pause);
        }
        drop(listener);
        pool.connections.retain(Connection::sends_the_page);
        let end = Instant::now() + limits.stop_time;
        while !pool.connections.is_empty() && Instant::now() < end {
            pool.advance(Instant::now());
            std::thread::sleep(PAUSES[0]);
        }
        Ok(pool.served)
    }
}

/// The open connections, the oldest first.
struct Pool<'a> {
    site: &'a Site<'a>,
    connections: Vec<Connection<'a>>,
    /// Number of requests that got the page.
    served: usize,
}

impl Pool<'_> {
    /// Advances every connection as far as it goes without waiting; returns whether bytes moved.
    fn advance(&mut self, now: Instant) -> bool {
        let mut is_active = false;
        let served = &mut self.served;
        self.connections.retain_mut(|connection| {
            let step = connection.advance(self.site, now);
            is_active |= step != Step::Waiting;
            *served += usize::from(step == Step::PageSent);
            !connection.is_closed()
        });
        is_active
    }

    /// Accepts connections; returns their number. If there are too many, the oldest one that does not receive
    /// the page is closed; if all receive it, new ones wait.
    ///
    /// # Errors
    /// The error of the system, apart from those of single connections.
    fn accept(&mut self, listener: &TcpListener) -> std::io::Result<usize> {
        // At most a quarter of the places per round: a flood of connections cannot remove one before it has
        // had several rounds to send its request.
        let most = (self.site.limits.connections / 4).max(1);
        for accepted in 0..most {
            // A connection that receives the page has sent the token. All others may belong to anybody.
            let oldest = self.connections.iter().position(|connection| !connection.sends_the_page());
            let is_full = self.connections.len() >= self.site.limits.connections;
            if is_full && oldest.is_none() {
                return Ok(accepted);
            }
            match listener.accept() {
                Ok((stream, peer)) => {
                    if let Some(oldest) = oldest.filter(|_| is_full) {
                        self.connections.remove(oldest);
                    }
                    // A connection that cannot be set up is already broken.
                    if let Ok(connection) = Connection::new(stream, peer, &self.site.limits) {
                        self.connections.push(connection);
                    }
                }
                Err(e) => {
                    return match e.kind() {
                        ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionAborted => {
                            Ok(accepted)
                        }
                        _ => Err(e),
                    };
                }
            }
        }
        Ok(most)
    }
}

#[cfg(test)]
mod tests;
