"""A server on this machine that serves real captures as the CMU database's site does."""

import threading
from contextlib import contextmanager
from email.utils import parsedate_to_datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

MOTIONS = {"02_01": "walk", "02_02": "walk", "02_03": "run/jog", "07_12": "brisk walk"}
FILES = [f"{name[:2]}/{name}.c3d" for name in MOTIONS]
HEAD = "<HTML><TABLE><TR><TH>Image<TH>Trial #<TH>Motion Description<TH>c3d<TH>Framerate</TR>"
ROW = (
    '<TR><TD>&nbsp;<TD>{number}<TD>{motion}<TD><A HREF="/subjects/{file}">c3d</A><TD>120<TD>'
    '<A HREF="/feedback.php">Feedback</A></TR>'
)


class Site:
    """Files by path; faults that befall the requests for a path, in turn; and what went out.

    A fault is a status to answer with, or "cut": a file ends after 100,000 bytes, a page without
    its end; or "stall": as a cut file, but the line stays open until `close`.
    """

    CUT = 100_000

    def __init__(self):
        self.files = {}
        self.faults = {}
        self.ranges = True
        self.modified = 1e9  # 2001
        self.asked = []  # path, Range header
        self.sent = {}  # path: ranges of bytes
        self.close = threading.Event()

    def answer(self, request):
        path = request.path
        self.asked.append((path, request.headers["Range"]))
        fault = self.faults[path].pop(0) if self.faults.get(path) else None
        since = request.headers["If-Unmodified-Since"]
        if isinstance(fault, int):
            request.send_error(fault)
        elif path not in self.files:
            request.send_error(404)
        elif since and self.modified > parsedate_to_datetime(since).timestamp():
            request.send_error(412)
        elif path.startswith("/search"):
            self.send_page(request, self.files[path], fault)
        else:
            self.send(request, self.files[path], fault)

    def send_page(self, request, content, fault):
        """As scripts answer: in chunks, the size untold."""
        request.send_response(200)
        request.send_header("Transfer-Encoding", "chunked")
        request.end_headers()
        for chunk in (content[:100], content[100:], b""):
            if chunk or fault != "cut":
                request.wfile.write(b"%x\r\n%b\r\n" % (len(chunk), chunk))

    def send(self, request, content, fault):
        start = 0
        if self.ranges and request.headers["Range"]:
            start = int(request.headers["Range"].removeprefix("bytes=").removesuffix("-"))
            if start >= len(content):
                request.send_error(416)
                return
            request.send_response(206)
            request.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        else:
            request.send_response(200)
        request.send_header("Content-Length", str(len(content) - start))
        request.end_headers()
        end = min(len(content), start + self.CUT) if fault else len(content)
        self.sent.setdefault(request.path, []).append((start, end))
        request.wfile.write(content[start:end])
        if fault == "stall":
            self.close.wait(60)

    @property
    def captures_asked(self):
        return [path for path, _ in self.asked if path.startswith("/subjects")]


@contextmanager
def serving(data_dir):
    """The site, with its address in `url`."""
    site = Site()
    rows = {}
    for file, motion in zip(FILES, MOTIONS.values(), strict=True):
        site.files[f"/subjects/{file}"] = (data_dir / "real" / file[3:]).read_bytes()
        row = ROW.format(number=int(file[6:8]), motion=motion, file=file)
        rows.setdefault(int(file[:2]), []).append(row)
    for subject, lines in rows.items():
        page = HEAD + "".join(lines) + "</TABLE></HTML>"
        site.files[f"/search.php?subjectnumber={subject}"] = page.encode()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self):
            site.answer(self)
            self.close_connection = True

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        site.url = f"http://127.0.0.1:{server.server_port}"
        yield site
        site.close.set()
        server.shutdown()
        thread.join()
