//! A small web server that shows one page to browsers on this computer.
//!
//! Comes in: a page of HTML. Goes out: answers to `GET /` (HTTP/1.1, RFC 9112) on a port of the loopback
//! address, which other computers cannot reach. Requests with another host name are refused: this stops
//! web sites that point their own name at this address (DNS rebinding).

use planish::{Error, Result};
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

/// Interval between checks for a stop: too short to notice, and long enough to leave the processor idle.
const PAUSE: Duration = Duration::from_millis(30);
/// Timeout of a connection. Requests are answered one at a time, so a silent connection would block the page.
const CONNECTION_TIMEOUT: Duration = Duration::from_secs(2);
/// Maximum size of a request, in bytes; a longer one is dropped.
const MAX_REQUEST: usize = 16 * 1024;

/// A server for one page.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
}

impl Server {
    /// Binds a port of the loopback address; without `port`, a free one.
    ///
    /// # Errors
    /// `Io` if the port is in use.
    pub fn on(port: Option<u16>) -> Result<Self> {
        let wanted = SocketAddr::from((Ipv4Addr::LOCALHOST, port.unwrap_or(0)));
        let made = TcpListener::bind(wanted).and_then(|listener| {
            // `accept` must not block: the loop in `serve` also has to look at `stop`.
            listener.set_nonblocking(true)?;
            let address = listener.local_addr()?;
            Ok(Self { listener, address })
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

    /// The address of the page.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Answers requests until `stop` returns true; returns the number of requests for the page.
    ///
    /// # Errors
    /// `Io` if the port is lost.
    pub fn serve(&self, page: &str, stop: impl Fn() -> bool) -> Result<usize> {
        let mut requests = 0;
        while !stop() {
            match self.listener.accept() {
                // A broken connection is the browser's problem; the server goes on.
                Ok((stream, _)) => {
                    requests += usize::from(answer(stream, page, self.address.port()).unwrap_or(false))
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => std::thread::sleep(PAUSE),
                Err(e) if e.kind() == ErrorKind::Interrupted || e.kind() == ErrorKind::ConnectionAborted => {}
                Err(e) => return Err(Error::io("the page could not be served any longer").with_source(e)),
            }
        }
        Ok(requests)
    }
}

/// Answers one request; returns whether it was for the page.
fn answer(mut stream: TcpStream, page: &str, port: u16) -> std::io::Result<bool> {
    // On some systems a stream inherits the mode of its listener. Reads with a timeout need blocking mode.
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(CONNECTION_TIMEOUT))?;
    stream.set_write_timeout(Some(CONNECTION_TIMEOUT))?;
    let mut request = Vec::new();
    let mut part = [0; 1024];
    while !request.windows(4).any(|end| end == b"\r\n\r\n") {
        let n = stream.read(&mut part)?;
        request.extend_from_slice(&part[..n]);
        // A closed connection or an oversized request gets no answer.
        if n == 0 || request.len() > MAX_REQUEST {
            return Ok(false);
        }
    }
    let request = String::from_utf8_lossy(&request);
    let (status, body) = response(&request, page, port);
    let method = request.split(' ').next().unwrap_or_default();
    // Nothing is cached, because the next run may serve another page at the same address.
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/html; charset=utf-8\r\nContent-Length: {}\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    if method != "HEAD" {
        stream.write_all(body.as_bytes())?;
    }
    stream.flush()?;
    Ok(status.starts_with("200"))
}

/// The status and the body of the response.
fn response<'a>(request: &str, page: &'a str, port: u16) -> (&'static str, &'a str) {
    let mut words = request.lines().next().unwrap_or_default().split(' ');
    let (method, path) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let host = (request.lines().skip(1))
        .filter_map(|line| line.split_once(':'))
        .find(|(name, _)| name.eq_ignore_ascii_case("host"))
        .map(|(_, host)| host.trim().to_ascii_lowercase());
    // A page of another site can reach this port from the same browser, but it cannot change the header
    // `Host`.
    let own = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    if !host.is_some_and(|host| own.contains(&host)) {
        return ("403 Forbidden", "This page is available on this computer only.");
    }
    match (method, path.split('?').next()) {
        ("GET" | "HEAD", Some("/")) => ("200 OK", page),
        ("GET" | "HEAD", _) => ("404 Not Found", "There is only one page: /"),
        _ => ("405 Method Not Allowed", "This page can only be read."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_requests_for_the_page_on_this_host_are_answered() {
        let status = |request: &str| response(request, "page", 80).0.split(' ').next().unwrap().to_owned();
        assert_eq!(status("GET / HTTP/1.1\r\nHost: 127.0.0.1:80\r\n\r\n"), "200");
        assert_eq!(status("GET /?a HTTP/1.1\r\nhost: LOCALHOST:80\r\n\r\n"), "200");
        assert_eq!(status("GET /x HTTP/1.1\r\nHost: 127.0.0.1:80\r\n\r\n"), "404");
        assert_eq!(status("POST / HTTP/1.1\r\nHost: 127.0.0.1:80\r\n\r\n"), "405");
        assert_eq!(status("GET / HTTP/1.1\r\nHost: elsewhere.example:80\r\n\r\n"), "403");
        assert_eq!(status("GET / HTTP/1.1\r\nHost: 127.0.0.1:81\r\n\r\n"), "403");
        assert_eq!(status("GET / HTTP/1.1\r\n\r\n"), "403");
        assert_eq!(status(""), "403");
    }
}
