//! `planish view`: images and pages of files.

use crate::support::{command, names, pebble, planish};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};

#[test]
fn image_is_written_and_described() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = planish(
        folder.path(),
        &["view", &pebble("truth.ply"), "-o", "a.png", "--camera=-30,20", "--size", "200x150", "--json"],
    )
    .ok()
    .json();
    assert_eq!(result["color"], "plain");
    assert_eq!(result["size"], serde_json::json!([200, 150]));
    assert!(result["covered"].as_f64().is_some_and(|covered| (0.2..0.8).contains(&covered)));
    assert_eq!(names(folder.path()), ["a.png"]);
    let bytes = std::fs::read(folder.path().join("a.png")).expect("a picture");
    assert!(bytes.starts_with(b"\x89PNG"));
    // The same command gives the same bytes with another number of threads.
    planish(
        folder.path(),
        &[
            "view",
            &pebble("truth.ply"),
            "-o",
            "b.png",
            "--camera=-30,20",
            "--size",
            "200x150",
            "--threads",
            "3",
        ],
    )
    .ok();
    assert_eq!(std::fs::read(folder.path().join("b.png")).expect("a picture"), bytes);
}

#[test]
fn page_is_written_on_request() {
    let folder = tempfile::tempdir().expect("a folder");
    planish(folder.path(), &["view", &pebble("truth.ply"), "-o", "a.html", "--quiet"]).ok();
    let page = std::fs::read_to_string(folder.path().join("a.html")).expect("a page");
    assert!(page.contains("A mesh of 5120 triangles") && page.contains("id=\"scene\""));
}

#[test]
fn unsupported_options_and_formats_are_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    for (args, words) in [
        (&["-o", "a.jpg"][..], "expected .png (an image) or .html (a page)"),
        (&["-o", "a.png", "--color", "sigma"], "--color"),
        (&["-o", "a.png", "--camera", "0,100"], "-90 to 90"),
        (&["--color", "plain"], "--output"),
        (&["-o", "a.png", "--port", "80"], "cannot be used with"),
    ] {
        let truth = pebble("truth.ply");
        let args: Vec<&str> = ["view", &truth].into_iter().chain(args.iter().copied()).collect();
        let result = planish(folder.path(), &args);
        assert_eq!(result.code, 2, "{args:?}: {}", result.stderr);
        let is_named = result.stderr.contains(words)
            || words == "--color" && result.stderr.contains("the field sigma to colour by");
        assert!(is_named, "{args:?}: {}", result.stderr);
    }
    assert!(names(folder.path()).is_empty());
}

/// `planish view` of the pebble; it is killed when the test ends.
struct Served {
    process: Child,
    /// Host and port.
    address: String,
    /// Path of the page, with the token.
    path: String,
}

impl Drop for Served {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Served {
    fn start(folder: &Path) -> Self {
        // Nobody can guess the address, so --no-open prints it even with --quiet.
        let mut process = command(folder, &["view", &pebble("truth.ply"), "--no-open", "--quiet", "--json"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("planish runs");
        let stderr = process.stderr.take().expect("stderr");
        let mut served = Self { process, address: String::new(), path: String::new() };
        let mut line = String::new();
        BufReader::new(stderr).read_line(&mut line).expect("a line");
        let url = line.split("http://").nth(1).and_then(|rest| rest.split(' ').next()).expect("an address");
        let (address, path) = url.split_once('/').expect("a path");
        served.address = address.to_owned();
        served.path = format!("/{path}");
        served
    }

    fn connect(&self) -> TcpStream {
        TcpStream::connect(&self.address).expect("a server")
    }

    /// The response to a request for a path.
    fn ask(&self, path: &str, host: &str) -> String {
        let mut stream = self.connect();
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("a request");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer
    }
}

#[test]
fn page_is_served_locally_until_ctrl_c() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut served = Served::start(folder.path());
    let address = served.address.clone();
    assert!(address.starts_with("127.0.0.1:"), "{address}");
    let page = served.ask(&served.path, &address);
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("A mesh of 5120 triangles"));
    let length =
        page.split("Content-Length: ").nth(1).and_then(|rest| rest.split('\r').next()).expect("a length");
    let (header, body) = page.split_once("\r\n\r\n").expect("a body");
    assert_eq!(body.len().to_string(), length);
    // The policy of the server is that of the page, which also protects a page that is opened as a file.
    let policy = header.split("Content-Security-Policy: ").nth(1).expect("a policy");
    let policy = policy.split("; frame-ancestors 'none'").next().expect("a policy");
    assert!(policy.contains("script-src 'sha256-") && !policy.contains("unsafe"), "{policy}");
    assert!(body.contains(&format!("content=\"{policy}\"")), "{policy}");
    // Other users of this computer do not know the token.
    for path in ["/", "/other", "/0123456789abcdef0123456789abcdef"] {
        assert!(served.ask(path, &address).starts_with("HTTP/1.1 404"), "{path}");
    }
    // A web site that points its own name at this address gets no data.
    assert!(served.ask(&served.path, "elsewhere.example").starts_with("HTTP/1.1 403"));
    #[cfg(unix)]
    {
        // A connection without a request does not delay the end.
        let _idle = served.connect();
        let stopped = std::process::Command::new("kill")
            .args(["-INT", &served.process.id().to_string()])
            .status()
            .expect("kill runs");
        assert!(stopped.success());
        let mut result = String::new();
        let mut stdout = served.process.stdout.take().expect("stdout");
        stdout.read_to_string(&mut result).expect("a summary");
        assert!(served.process.wait().expect("an end").success());
        let result: Value = serde_json::from_str(&result).expect("JSON");
        assert_eq!(result["requests"], 1);
        assert_eq!(result["address"], format!("http://{address}{}", served.path));
        assert!(TcpStream::connect(address).is_err(), "the server is gone");
    }
}

#[test]
fn every_run_has_another_address_and_idle_connections_delay_nobody() {
    let folder = tempfile::tempdir().expect("a folder");
    let [first, second] = [(); 2].map(|()| Served::start(folder.path()));
    assert_ne!(first.path, second.path);
    assert!(second.ask(&first.path, &second.address).starts_with("HTTP/1.1 404"));
    // More silent clients than the server has places. One at a time, each would delay the page by seconds.
    let idle: Vec<TcpStream> = (0..100).map(|_| first.connect()).collect();
    for _ in 0..20 {
        assert!(first.ask(&first.path, &first.address).starts_with("HTTP/1.1 200"));
    }
    drop(idle);
}

#[test]
fn port_in_use_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = listener.local_addr().expect("a port").port().to_string();
    let result = planish(folder.path(), &["view", &pebble("truth.ply"), "--no-open", "--port", &port]);
    assert_eq!(result.code, 3, "{}", result.stderr);
    assert!(result.stderr.contains(&port) && result.stderr.contains("--port"), "{}", result.stderr);
}
