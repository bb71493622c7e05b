//! The server with raw TCP clients: silent, slow, wrong and hostile ones.

use super::*;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};

/// More than the buffers of a connection hold, so that a client who does not read blocks the transfer.
const LARGE: usize = 16 << 20;

/// The address and the token of a running server.
struct Site {
    address: SocketAddr,
    token: String,
}

/// Runs a test with a server; returns the result of the server.
fn with_server(limits: Limits, html: &str, test: impl FnOnce(&Site, &AtomicBool)) -> usize {
    let mut server = Server::on(None).unwrap();
    server.limits = limits;
    let site = Site { address: server.address, token: server.token.text().to_owned() };
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let page = ServedPage { html, policy: "default-src 'none'" };
        let stop = &stop;
        let served = scope.spawn(move || server.serve(&page, || stop.load(Ordering::Relaxed)).unwrap());
        // The server must also stop if the test fails, or the scope would never end.
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| test(&site, stop)));
        stop.store(true, Ordering::Relaxed);
        let served = served.join().unwrap();
        result.map(|()| served).unwrap_or_else(|failure| std::panic::resume_unwind(failure))
    })
}

impl Site {
    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        // A server that never answers is a failure, not a test without end.
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream
    }

    fn request(&self, method: &str) -> String {
        format!("{method} /{} HTTP/1.1\r\nHost: {}\r\n\r\n", self.token, self.address)
    }

    /// The response to bytes, up to the end of the stream.
    fn ask(&self, request: &str) -> String {
        let mut stream = self.connect();
        stream.write_all(request.as_bytes()).unwrap();
        rest(&mut stream)
    }
}

/// Everything up to the end of the stream, which must not be a reset.
fn rest(stream: &mut TcpStream) -> String {
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

fn status(answer: &str) -> &str {
    answer.strip_prefix("HTTP/1.1 ").and_then(|rest| rest.get(..3)).unwrap_or(answer)
}

fn body(answer: &str) -> &str {
    answer.split_once("\r\n\r\n").unwrap().1
}

#[test]
fn the_page_needs_the_token_and_the_host() {
    let served = with_server(Limits::default(), "<p>page", |site, _| {
        let page = site.ask(&site.request("GET"));
        assert_eq!((status(&page), body(&page)), ("200", "<p>page"));
        assert!(page.contains("Content-Length: 7\r\n") && page.contains("Cache-Control: no-store\r\n"));
        assert!(page.contains("Content-Security-Policy: default-src 'none'; frame-ancestors 'none'\r\n"));
        let header = site.ask(&site.request("HEAD"));
        assert_eq!(header, page.strip_suffix("<p>page").unwrap());
        let request = site.request("GET");
        let mut wrong = site.token.clone();
        wrong.replace_range(31.., if wrong.ends_with('0') { "1" } else { "0" });
        let port = site.address.port();
        for (request, expected) in [
            (request.replace(&site.token, ""), "404"),
            (request.replace(&site.token, &wrong), "404"),
            (request.replace(&site.token, &site.token[..31]), "404"),
            (request.replace("127.0.0.1", "elsewhere.example"), "403"),
            (request.replace(&format!(":{port}"), &format!(":{}", port ^ 1)), "403"),
            (site.request("POST"), "405"),
            (site.request("POST").replace(&site.token, ""), "404"),
            (request.replace("HTTP/1.1", "HTTP/3.0"), "505"),
            (request.replace("Host", "Guest"), "400"),
        ] {
            let answer = site.ask(&request);
            assert_eq!(status(&answer), expected, "{request}");
            assert!(!answer.contains("<p>") && !answer.contains(&site.token), "{answer}");
        }
        assert!(site.ask(&site.request("PUT")).contains("\r\nAllow: GET, HEAD\r\n"));
    });
    assert_eq!(served, 2);
}

#[test]
fn older_clients_and_requests_in_parts_are_answered() {
    with_server(Limits::default(), "page", |site, _| {
        assert_eq!(body(&site.ask(&format!("GET /{} HTTP/1.0\r\n\r\n", site.token))), "page");
        assert_eq!(body(&site.ask(&format!("\r\n{}", site.request("GET")))), "page");
        assert_eq!(body(&site.ask(&site.request("GET").replace("\r\n", "\n"))), "page");
        // Each byte is a packet of its own.
        let mut stream = site.connect();
        stream.set_nodelay(true).unwrap();
        for byte in site.request("GET").as_bytes() {
            stream.write_all(&[*byte]).unwrap();
            std::thread::yield_now();
        }
        assert_eq!(body(&rest(&mut stream)), "page");
        // The client ends its side before it reads.
        let mut stream = site.connect();
        stream.write_all(site.request("GET").as_bytes()).unwrap();
        stream.shutdown(Shutdown::Write).unwrap();
        assert_eq!(body(&rest(&mut stream)), "page");
        // An incomplete request has no answer.
        let mut stream = site.connect();
        stream.write_all(b"GET / HTTP/1.1\r\nHost").unwrap();
        stream.shutdown(Shutdown::Write).unwrap();
        assert_eq!(rest(&mut stream), "");
    });
}

#[test]
fn requests_behind_the_first_are_discarded_without_a_reset() {
    let html = "x".repeat(LARGE / 8);
    let served = with_server(Limits::default(), &html, |site, _| {
        let answer = site.ask(&site.request("GET").repeat(50));
        assert_eq!(answer.matches("HTTP/1.1 200").count(), 1);
        assert!(answer.contains("\r\nConnection: close\r\n"));
        assert_eq!(body(&answer).len(), html.len());
        // A body of a request that is refused anyway.
        let upload = format!("{}{}", site.request("POST"), "y".repeat(200_000));
        assert_eq!(status(&site.ask(&upload)), "405");
    });
    assert_eq!(served, 1);
}

#[test]
fn large_headers_and_other_protocols_are_refused_at_once() {
    // The time for a header is far longer than a test may wait.
    let limits = Limits { header_time: Duration::from_secs(600), ..Limits::default() };
    with_server(limits, "page", |site, _| {
        let request = site.request("GET");
        let padded = |bytes: usize| {
            let field = "\r\nPad: \r\n\r\n".len() - "\r\n\r\n".len();
            let pad = "p".repeat(bytes - request.len() - field);
            request.replace("\r\n\r\n", &format!("\r\nPad: {pad}\r\n\r\n"))
        };
        assert_eq!(padded(limits.header_bytes).len(), limits.header_bytes);
        assert_eq!(status(&site.ask(&padded(limits.header_bytes))), "200");
        assert_eq!(status(&site.ask(&padded(limits.header_bytes + 1))), "431");
        assert_eq!(status(&site.ask(&padded(300_000))), "431");
        // Without an end.
        assert_eq!(status(&site.ask(&format!("GET /{}", "a".repeat(300_000)))), "431");
        assert_eq!(status(&site.ask(&"a: b\r\n".repeat(50_000))), "431");
        // A greeting of TLS 1.2.
        assert_eq!(status(&site.ask("\x16\x03\x01\x02\0\x01")), "400");
        assert_eq!(status(&site.ask("\0")), "400");
    });
}

#[test]
fn idle_and_slow_clients_delay_nobody() {
    // No time limit ends during the test, so only the concurrency can help.
    let forever = Duration::from_secs(600);
    let limits =
        Limits { header_time: forever, response_time: forever, close_time: forever, ..Limits::default() };
    let html = "x".repeat(LARGE);
    let served = with_server(limits, &html, |site, _| {
        let idle: Vec<TcpStream> = (0..10).map(|_| site.connect()).collect();
        let mut unfinished: Vec<TcpStream> = (0..10).map(|_| site.connect()).collect();
        for stream in &mut unfinished {
            stream.write_all(site.request("GET").trim_end().as_bytes()).unwrap();
        }
        // Clients that ask for the page and do not read it.
        let mut unread: Vec<TcpStream> = (0..10).map(|_| site.connect()).collect();
        for stream in &mut unread {
            stream.write_all(site.request("GET").as_bytes()).unwrap();
        }
        for _ in 0..3 {
            assert_eq!(body(&site.ask(&site.request("GET"))).len(), LARGE);
        }
        // The slow ones are not lost.
        for stream in &mut unfinished[..2] {
            stream.write_all(b"\r\n\r\n").unwrap();
            assert_eq!(body(&rest(stream)).len(), LARGE);
        }
        assert_eq!(body(&rest(&mut unread[0])).len(), LARGE);
        drop(idle);
    });
    assert_eq!(served, 6);
}

#[test]
fn more_connections_than_places_displace_those_that_wait() {
    let forever = Duration::from_secs(600);
    let limits = Limits {
        connections: 8,
        header_time: forever,
        response_time: forever,
        close_time: forever,
        ..Limits::default()
    };
    let html = "x".repeat(LARGE);
    with_server(limits, &html, |site, _| {
        let mut reader = site.connect();
        reader.write_all(site.request("GET").as_bytes()).unwrap();
        let mut first = [0; 1];
        reader.read_exact(&mut first).unwrap();
        let mut idle: Vec<TcpStream> = (0..100).map(|_| site.connect()).collect();
        assert_eq!(status(&site.ask(&site.request("HEAD"))), "200");
        // Closed by the server. A reset is an end, too.
        assert!(matches!(idle[0].read(&mut first), Ok(0) | Err(_)));
        // A transfer of the page is never displaced.
        assert!(rest(&mut reader).ends_with('x'));
    });
}

#[test]
fn as_many_connections_as_places_stay_open() {
    let limits = Limits { connections: 8, ..Limits::default() };
    with_server(limits, "page", |site, _| {
        let mut idle: Vec<TcpStream> = (0..8).map(|_| site.connect()).collect();
        std::thread::sleep(Duration::from_millis(200));
        for stream in &mut idle {
            stream.write_all(site.request("GET").as_bytes()).unwrap();
            assert_eq!(body(&rest(stream)), "page");
        }
    });
}

#[test]
fn parallel_requests_all_get_the_page() {
    let html = "x".repeat(300_000);
    let served = with_server(Limits::default(), &html, |site, _| {
        std::thread::scope(|scope| {
            let clients: Vec<_> = (0..32)
                .map(|_| {
                    scope.spawn(|| (0..4).map(|_| body(&site.ask(&site.request("GET"))).len()).collect())
                })
                .collect();
            for client in clients {
                let lengths: Vec<usize> = client.join().unwrap();
                assert_eq!(lengths, [html.len(); 4]);
            }
        });
    });
    assert_eq!(served, 128);
}

#[test]
fn time_limits_end_every_stage() {
    let short = Duration::from_millis(100);
    let limits = Limits {
        header_time: short,
        response_time: short,
        close_time: short,
        bytes_per_second: usize::MAX,
        ..Limits::default()
    };
    let html = "x".repeat(LARGE);
    let served = with_server(limits, &html, |site, _| {
        // Silent from the beginning: browsers open such connections, and expect no response.
        assert_eq!(rest(&mut site.connect()), "");
        // Silent in the middle.
        assert_eq!(status(&site.ask("GET / HT")), "408");
        // A byte now and then does not extend the time.
        let mut stream = site.connect();
        let mut answered = false;
        for _ in 0..2000 {
            let is_sent = stream.write_all(b"a").is_ok();
            std::thread::sleep(Duration::from_millis(5));
            stream.set_nonblocking(true).unwrap();
            answered |= stream.read(&mut [0; 1]).is_ok();
            stream.set_nonblocking(false).unwrap();
            if answered || !is_sent {
                break;
            }
        }
        assert!(answered, "the header never expired");
        // A client that reads slowly is cut off in the middle of the page.
        let mut stream = site.connect();
        stream.write_all(site.request("GET").as_bytes()).unwrap();
        std::thread::sleep(5 * short);
        let mut answer = Vec::new();
        // The cut may be an end or a reset.
        let _ = stream.read_to_end(&mut answer);
        assert!(answer.len() < LARGE, "{}", answer.len());
    });
    assert_eq!(served, 0);
}

#[test]
fn a_stop_ends_transfers_of_the_page_and_drops_the_rest() {
    let limits = Limits { stop_time: Duration::from_secs(20), ..Limits::default() };
    let html = "x".repeat(LARGE);
    let mut address = None;
    let served = with_server(limits, &html, |site, stop| {
        let mut reader = site.connect();
        reader.write_all(site.request("GET").as_bytes()).unwrap();
        reader.read_exact(&mut [0; 1]).unwrap();
        let mut idle = site.connect();
        stop.store(true, Ordering::Relaxed);
        assert!(matches!(idle.read(&mut [0; 1]), Ok(0) | Err(_)));
        assert_eq!(body(&rest(&mut reader)).len(), LARGE);
        address = Some(site.address);
    });
    assert_eq!(served, 1);
    assert!(TcpStream::connect(address.unwrap()).is_err(), "the server is gone");
}

#[test]
fn a_stop_does_not_wait_for_clients_that_do_not_read() {
    let limits = Limits { stop_time: Duration::from_millis(50), ..Limits::default() };
    let html = "x".repeat(LARGE);
    let served = with_server(limits, &html, |site, stop| {
        let mut reader = site.connect();
        reader.write_all(site.request("GET").as_bytes()).unwrap();
        reader.read_exact(&mut [0; 1]).unwrap();
        stop.store(true, Ordering::Relaxed);
        std::thread::sleep(Duration::from_millis(500));
        let mut answer = Vec::new();
        let _ = reader.read_to_end(&mut answer);
        assert!(answer.len() < LARGE);
    });
    assert_eq!(served, 0);
}
