//! Responses: their header, and the part of them that is still to be sent.

/// The page of a server.
pub struct ServedPage<'a> {
    /// The page.
    pub html: &'a str,
    /// Its content security policy, without directives that apply only to the header field.
    pub policy: &'a str,
}

/// Status of a response.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Status {
    Ok,
    BadRequest,
    Forbidden,
    NotFound,
    MethodNotAllowed,
    RequestTimeout,
    HeaderTooLarge,
    VersionNotSupported,
}

impl Status {
    /// Code and name (RFC 9110, section 15; RFC 6585, section 5).
    fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::MethodNotAllowed => "405 Method Not Allowed",
            Self::RequestTimeout => "408 Request Timeout",
            Self::HeaderTooLarge => "431 Request Header Fields Too Large",
            Self::VersionNotSupported => "505 HTTP Version Not Supported",
        }
    }

    /// The explanation for a person.
    fn text(self) -> &'static str {
        match self {
            Self::Ok => "",
            Self::BadRequest => "Expected an HTTP/1.1 request with one field Host.\n",
            Self::Forbidden => "This page is only for browsers on this computer.\n",
            Self::NotFound => "Expected the complete address that `planish view` printed.\n",
            Self::MethodNotAllowed => "This page can only be read (GET or HEAD).\n",
            Self::RequestTimeout => "The request took too long.\n",
            Self::HeaderTooLarge => "The header of the request is too large.\n",
            Self::VersionNotSupported => "Expected HTTP/1.1 or HTTP/1.0.\n",
        }
    }
}

/// A response, and how much of it was sent.
pub(super) struct Response<'a> {
    status: Status,
    header: String,
    body: &'a str,
    sent: usize,
}

impl<'a> Response<'a> {
    /// Creates a response; `is_head` omits the body.
    pub fn new(status: Status, page: &ServedPage<'a>, is_head: bool) -> Self {
        let (kind, policy, body) = match status {
            Status::Ok => ("html", page.policy, page.html),
            other => ("plain", "default-src 'none'", other.text()),
        };
        let allow = if status == Status::MethodNotAllowed { "Allow: GET, HEAD\r\n" } else { "" };
        // Nothing is stored, because the data are private and the next run may serve another page at this
        // port. No other site may show or load the page, or learn its address from a link.
        let header = format!(
            "HTTP/1.1 {}\r\nContent-Type: text/{kind}; charset=utf-8\r\nContent-Length: {}\r\n{allow}\
             Cache-Control: no-store\r\nContent-Security-Policy: {policy}; frame-ancestors 'none'\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\nReferrer-Policy: no-referrer\r\n\
             X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n",
            status.line(),
            body.len()
        );
        Self { status, header, body: if is_head { "" } else { body }, sent: 0 }
    }

    /// True if this response grants the page.
    pub fn is_page(&self) -> bool {
        self.status == Status::Ok
    }

    /// Number of bytes in total.
    pub fn len(&self) -> usize {
        self.header.len() + self.body.len()
    }

    /// The next bytes to send; empty at the end.
    pub fn rest(&self) -> &[u8] {
        match self.header.as_bytes().get(self.sent..) {
            Some(rest) if !rest.is_empty() => rest,
            _ => &self.body.as_bytes()[self.sent - self.header.len()..],
        }
    }

    /// Counts bytes of [`Self::rest`] as sent.
    pub fn advance(&mut self, count: usize) {
        self.sent += count;
    }
}
