//! A page for the browsers of this computer, until somebody presses Ctrl-C.
//!
//! Comes in: a page of HTML. Goes out: answers to `GET /` (HTTP/1.1, RFC 9112) on a port of the loopback
//! address, which no other computer reaches. Requests that name another host are refused, so that no page
//! from elsewhere reads this one under a name of its own.

use planish::{Error, Result};
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

/// How often is looked whether to stop.
const PAUSE: Duration = Duration::from_millis(30);
/// A browser that says nothing for so long is not waited for.
const PATIENCE: Duration = Duration::from_secs(2);
/// No request of a browser is longer.
const LONGEST: usize = 16 * 1024;

/// A page that is served.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
}

impl Server {
    /// Takes a port of the loopback address; one that is free where none is given.
    ///
    /// # Errors
    /// `Io` where the port is taken.
    pub fn on(port: Option<u16>) -> Result<Self> {
        let wanted = SocketAddr::from((Ipv4Addr::LOCALHOST, port.unwrap_or(0)));
        let made = TcpListener::bind(wanted).and_then(|listener| {
            listener.set_nonblocking(true)?;
            let address = listener.local_addr()?;
            Ok(Self { listener, address })
        });
        made.map_err(|e| {
            Error::io(match port {
                Some(port) => format!(
                    "port {port} of this computer could not be used: another program may have it; leave --port out"
                ),
                None => "no port of this computer could be used".to_owned(),
            })
            .with_source(e)
        })
    }

    /// Where the page is.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Answers until `stop` says so; how often the page was asked for.
    ///
    /// # Errors
    /// `Io` where the port is lost.
    pub fn serve(&self, page: &str, stop: impl Fn() -> bool) -> Result<usize> {
        let mut asked = 0;
        while !stop() {
            match self.listener.accept() {
                // A browser that goes away in the middle harms only itself.
                Ok((stream, _)) => {
                    asked += usize::from(answer(stream, page, self.address.port()).unwrap_or(false))
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => std::thread::sleep(PAUSE),
                Err(e) if e.kind() == ErrorKind::Interrupted || e.kind() == ErrorKind::ConnectionAborted => {}
                Err(e) => return Err(Error::io("the page can no longer be served").with_source(e)),
            }
        }
        Ok(asked)
    }
}

/// Answers one request; whether it was for the page.
fn answer(mut stream: TcpStream, page: &str, port: u16) -> std::io::Result<bool> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut request = Vec::new();
    let mut part = [0; 1024];
    while !request.windows(4).any(|end| end == b"\r\n\r\n") {
        let n = stream.read(&mut part)?;
        request.extend_from_slice(&part[..n]);
        if n == 0 || request.len() > LONGEST {
            return Ok(false);
        }
    }
    let request = String::from_utf8_lossy(&request);
    let (status, body) = response(&request, page, port);
    let method = request.split(' ').next().unwrap_or_default();
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/html; charset=utf-8\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    if method != "HEAD" {
        stream.write_all(body.as_bytes())?;
    }
    stream.flush()?;
    Ok(status.starts_with("200"))
}

/// The status and the body for a request.
fn response<'a>(request: &str, page: &'a str, port: u16) -> (&'static str, &'a str) {
    let mut words = request.lines().next().unwrap_or_default().split(' ');
    let (method, path) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let host = (request.lines().skip(1))
        .filter_map(|line| line.split_once(':'))
        .find(|(name, _)| name.eq_ignore_ascii_case("host"))
        .map(|(_, host)| host.trim().to_ascii_lowercase());
    let own = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    if !host.is_some_and(|host| own.contains(&host)) {
        return ("403 Forbidden", "This page is for this computer only.");
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
    fn only_the_page_and_only_for_this_computer() {
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
