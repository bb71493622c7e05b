//! Requests (RFC 9112): finding their end, and deciding on the response.

use super::response::Status;
use super::token::Token;

/// Number of bytes of empty lines at the beginning; some clients send one, and it is ignored (RFC 9112,
/// section 2.2).
pub(super) fn leading_empty_lines(received: &[u8]) -> usize {
    received.iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count()
}

/// End of the request line and the header fields: behind the first empty line, if that has arrived. The
/// search begins at `from`. A line may end in LF alone (RFC 9112, section 2.2).
pub(super) fn header_end(received: &[u8], from: usize) -> Option<usize> {
    (from..received.len()).filter(|&place| received[place] == b'\n').find_map(|place| {
        match received.get(place + 1..) {
            Some([b'\n', ..]) => Some(place + 2),
            Some([b'\r', b'\n', ..]) => Some(place + 3),
            _ => None,
        }
    })
}

/// The decision on a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Decision {
    /// [`Status::Ok`] if the request gets the page.
    pub status: Status,
    /// True if the response consists of the header only.
    pub is_head: bool,
}

/// Decides on a request for a server on this port of the loopback address.
pub(super) fn decide(header: &[u8], token: &Token, port: u16) -> Decision {
    let header = String::from_utf8_lossy(header);
    Decision {
        is_head: header.starts_with("HEAD "),
        status: match status(&header, token, port) {
            Ok(()) => Status::Ok,
            Err(status) => status,
        },
    }
}

/// Checks the form, then the host, then the token, then the method. A client without the token learns nothing
/// about the page.
fn status(header: &str, token: &Token, port: u16) -> Result<(), Status> {
    let mut lines = header.lines();
    let words: Vec<&str> = lines.next().unwrap_or_default().split(' ').collect();
    let [method, target, version] = words[..] else { return Err(Status::BadRequest) };
    match version.strip_prefix("HTTP/").map(str::as_bytes) {
        Some([b'1', b'.', minor]) if minor.is_ascii_digit() => {}
        Some(_) => return Err(Status::VersionNotSupported),
        None => return Err(Status::BadRequest),
    }
    let hosts = hosts(lines)?;
    match &hosts[..] {
        // Only HTTP/1.0 permits requests without a host (RFC 9112, section 3.2). Browsers do not send them.
        [] if version != "HTTP/1.0" => return Err(Status::BadRequest),
        [] | [_] => {}
        _ => return Err(Status::BadRequest),
    }
    // The absolute form (RFC 9112, section 3.2.2) names the host a second time.
    let scheme = "http://";
    let (authority, path) = match target.get(..scheme.len()) {
        Some(start) if start.eq_ignore_ascii_case(scheme) => {
            let rest = &target[scheme.len()..];
            let (authority, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
            (Some(authority), path)
        }
        _ => (None, target),
    };
    // A page of another site can reach this port from the same browser, but it cannot choose the host.
    if !hosts.iter().chain(&authority).all(|host| is_own(host, port)) {
        return Err(Status::Forbidden);
    }
    let path = path.split('?').next().unwrap_or_default();
    if !path.strip_prefix('/').is_some_and(|given| token.equals(given)) {
        return Err(Status::NotFound);
    }
    match method {
        "GET" | "HEAD" => Ok(()),
        _ => Err(Status::MethodNotAllowed),
    }
}

/// The values of the field `Host`.
fn hosts<'a>(lines: impl Iterator<Item = &'a str>) -> Result<Vec<&'a str>, Status> {
    let mut hosts = Vec::new();
    for line in lines.take_while(|line| !line.is_empty()) {
        // A continued line, or a space before the colon, could hide a field from a simple reader.
        let (name, value) = line.split_once(':').ok_or(Status::BadRequest)?;
        if name.is_empty() || name.contains(|c: char| c.is_whitespace() || c.is_control()) {
            return Err(Status::BadRequest);
        }
        if value.contains(|c: char| c.is_control() && c != '\t') {
            return Err(Status::BadRequest);
        }
        if name.eq_ignore_ascii_case("host") {
            hosts.push(value.trim_matches([' ', '\t']));
        }
    }
    Ok(hosts)
}

/// True if a host is this server.
fn is_own(host: &str, port: u16) -> bool {
    ["127.0.0.1", "localhost"].iter().any(|name| {
        let Some(start) = host.get(..name.len()) else { return false };
        start.eq_ignore_ascii_case(name)
            && match &host[name.len()..] {
                // Browsers omit the port of the scheme.
                "" => port == 80,
                rest => rest.strip_prefix(':') == Some(port.to_string().as_str()),
            }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Status of a request in which `TOKEN` stands for the token.
    fn decided(request: &str) -> Decision {
        let token = Token::random().unwrap();
        decide(request.replace("TOKEN", token.text()).as_bytes(), &token, 8080)
    }

    #[test]
    fn only_requests_with_the_token_on_this_host_get_the_page() {
        use Status::*;
        for (request, expected) in [
            ("GET /TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", Ok),
            ("GET /TOKEN?a HTTP/1.1\r\nA: b\r\nhost:\tLOCALHOST:8080 \r\n\r\n", Ok),
            ("GET /TOKEN HTTP/1.1\nHost: localhost:8080\n\n", Ok),
            ("HEAD /TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", Ok),
            ("GET HTTP://localhost:8080/TOKEN HTTP/1.1\r\nHost: localhost:8080\r\n\r\n", Ok),
            ("GET /TOKEN HTTP/1.0\r\n\r\n", Ok),
            ("GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", NotFound),
            ("GET /TOKEN/ HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", NotFound),
            ("GET /?TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", NotFound),
            ("GET TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", NotFound),
            ("GET //TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", NotFound),
            ("OPTIONS * HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", NotFound),
            ("POST / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", NotFound),
            ("POST /TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", MethodNotAllowed),
            ("get /TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n", MethodNotAllowed),
            ("GET /TOKEN HTTP/1.1\r\nHost: elsewhere.example:8080\r\n\r\n", Forbidden),
            ("GET /TOKEN HTTP/1.1\r\nHost: localhost.example:8080\r\n\r\n", Forbidden),
            ("GET /TOKEN HTTP/1.1\r\nHost: 127.0.0.1:8081\r\n\r\n", Forbidden),
            ("GET /TOKEN HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", Forbidden),
            ("GET /TOKEN HTTP/1.1\r\nHost: \r\n\r\n", Forbidden),
            ("GET /TOKEN HTTP/1.0\r\nHost: elsewhere.example\r\n\r\n", Forbidden),
            ("GET http://elsewhere.example/TOKEN HTTP/1.1\r\nHost: localhost:8080\r\n\r\n", Forbidden),
            ("GET /TOKEN HTTP/1.1\r\n\r\n", BadRequest),
            ("GET /TOKEN HTTP/1.1\r\nHost: localhost:8080\r\nHost: localhost:8080\r\n\r\n", BadRequest),
            ("GET /TOKEN HTTP/1.1\r\nHost : localhost:8080\r\n\r\n", BadRequest),
            ("GET /TOKEN HTTP/1.1\r\nHost: localhost:8080\r\n folded\r\n\r\n", BadRequest),
            ("GET /TOKEN HTTP/1.1\r\nHost: localhost:8080\r\nA: \0\r\n\r\n", BadRequest),
            ("GET /TOKEN\r\nHost: localhost:8080\r\n\r\n", BadRequest),
            ("GET  /TOKEN HTTP/1.1\r\nHost: localhost:8080\r\n\r\n", BadRequest),
            ("GET /TOKEN FTP/1.1\r\nHost: localhost:8080\r\n\r\n", BadRequest),
            ("", BadRequest),
            ("PRI * HTTP/2.0\r\n\r\n", VersionNotSupported),
            ("GET /TOKEN HTTP/1.12\r\nHost: localhost:8080\r\n\r\n", VersionNotSupported),
        ] {
            assert_eq!(decided(request).status, expected, "{request:?}");
            assert_eq!(decided(request).is_head, request.starts_with("HEAD"), "{request:?}");
        }
    }

    #[test]
    fn the_port_of_the_scheme_may_be_omitted() {
        assert!(is_own("localhost", 80) && is_own("127.0.0.1:80", 80) && !is_own("localhost:", 80));
    }

    #[test]
    fn the_end_of_a_header_is_found_in_parts_of_any_size() {
        for request in [
            "GET / HTTP/1.1\r\nA: b\r\n\r\nrest",
            "GET / HTTP/1.1\nA: b\n\nrest",
            "GET / HTTP/1.1\r\nA: b\n\r\nrest",
        ] {
            let end = request.len() - "rest".len();
            for length in 0..=request.len() {
                let found = header_end(&request.as_bytes()[..length], 0);
                assert_eq!(found, (length >= end).then_some(end), "{:?}", &request[..length]);
            }
        }
        assert_eq!(leading_empty_lines(b"\r\n\r\nGET"), 4);
    }
}
