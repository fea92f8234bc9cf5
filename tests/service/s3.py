"""A server with the S3 interface for tests. It verifies presigned requests (AWS signature version 4) with code of its own.

s3.py FOLDER. A folder in FOLDER is a bucket, a file below it an object. The first line of the output is the port.
Environment: S3_KEY, S3_SECRET, S3_REGION, S3_PORT (0: any free one). It ends when its standard input ends.
FOLDER/.log gets a line per request: METHOD BUCKET/KEY STATUS. FOLDER/.fails, while present, makes requests fail:
"503 HEAD PUT" answers 503 to these methods, "half PUT" keeps half of what it takes.
"""

import base64, hashlib, hmac, os, re, sys, threading
from datetime import datetime, timedelta, timezone
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, unquote

DATA = Path(sys.argv[1])
KEY, SECRET, REGION = (os.environ[name] for name in ("S3_KEY", "S3_SECRET", "S3_REGION"))


def encoded(text, safe=""):
    return quote(text, safe=safe + "-_.~")


def refusal(method, path, query, headers):
    """What is wrong with a presigned request: code and further elements of the answer; None if it is right."""
    pairs = [tuple(map(unquote, pair.partition("=")[::2])) for pair in query.split("&") if pair]
    given = dict(pairs)
    try:
        key, day, _, _, _ = given["X-Amz-Credential"].split("/")
        begin = datetime.strptime(given["X-Amz-Date"], "%Y%m%dT%H%M%SZ").replace(tzinfo=timezone.utc)
        names, expires = given["X-Amz-SignedHeaders"].split(";"), int(given["X-Amz-Expires"])
        provided, algorithm = given["X-Amz-Signature"], given["X-Amz-Algorithm"]
    except (KeyError, ValueError):
        return "AccessDenied", ""
    now = datetime.now(timezone.utc)
    is_now = begin - timedelta(minutes=15) <= now <= begin + timedelta(seconds=expires)
    unsigned = [name for name in map(str.lower, headers) if name.startswith("x-amz-") and name not in names]
    is_whole = "host" in names and names == sorted(names) and all(name in headers for name in names)
    if algorithm != "AWS4-HMAC-SHA256" or not is_now or not 1 <= expires <= 604800 or unsigned or not is_whole:
        return "AccessDenied", ""
    if key != KEY:
        return "InvalidAccessKeyId", f"<AWSAccessKeyId>{key}</AWSAccessKeyId>"
    signed = sorted((encoded(k), encoded(v)) for k, v in pairs if k != "X-Amz-Signature")
    canonical = [method, encoded(unquote(path), "/"), "&".join(f"{k}={v}" for k, v in signed)]
    canonical += [f"{name}:{re.sub(' +', ' ', headers[name].strip())}" for name in names]
    canonical += ["", ";".join(names), "UNSIGNED-PAYLOAD"]
    scope = f"{begin:%Y%m%d}/{REGION}/s3/aws4_request"
    digest = hashlib.sha256("\n".join(canonical).encode()).hexdigest()
    text = "\n".join(["AWS4-HMAC-SHA256", given["X-Amz-Date"], scope, digest])
    chain = ("AWS4" + SECRET).encode()
    for word in scope.split("/") + [text]:
        chain = hmac.new(chain, word.encode(), hashlib.sha256).digest()
    if day != f"{begin:%Y%m%d}" or not hmac.compare_digest(chain.hex(), provided):
        told = f"<AWSAccessKeyId>{key}</AWSAccessKeyId><SignatureProvided>{provided}</SignatureProvided>"
        return "SignatureDoesNotMatch", f"{told}<StringToSign>{text}</StringToSign>"
    return None


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def answer(self, status, body=b"", length=None):
        with open(DATA / ".log", "a") as log:
            log.write(f"{self.command} {unquote(self.path.partition('?')[0]).lstrip('/')} {status}\n")
        self.send_response(status)
        self.send_header("Content-Length", str(len(body) if length is None else length))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def fail(self, status, code, more=""):
        self.answer(status, f"<?xml version=\"1.0\"?>\n<Error><Code>{code}</Code><Message>As told.</Message>{more}</Error>".encode())

    def serve(self):
        path, _, query = self.path.partition("?")
        if self.command == "PUT" and "Content-Length" not in self.headers:
            self.close_connection = True
            return self.fail(411, "MissingContentLength")
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        fails = DATA / ".fails"
        how, *methods = (fails.read_text() if fails.exists() else "").split() or [""]
        how = how if self.command in methods else ""
        if how == "503":
            return self.fail(503, "SlowDown")
        if wrong := refusal(self.command, path, query, self.headers):
            return self.fail(403, *wrong)
        bucket, _, key = unquote(path).lstrip("/").partition("/")
        place = DATA / bucket / key
        if not (DATA / bucket).is_dir():
            return self.fail(404, "NoSuchBucket")
        if self.command != "PUT":
            if not place.is_file():
                return self.fail(404, "NoSuchKey")
            data = place.read_bytes()
            return self.answer(200, data, len(data))
        sum_given = self.headers.get("x-amz-checksum-sha256")
        if sum_given and sum_given != base64.b64encode(hashlib.sha256(body).digest()).decode():
            return self.fail(400, "BadDigest")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(body[: len(body) // 2] if how == "half" else body)
        self.answer(200)

    do_GET = do_HEAD = do_PUT = serve

    def log_message(self, *_):
        pass


server = ThreadingHTTPServer(("127.0.0.1", int(os.environ.get("S3_PORT", "0"))), Handler)
threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
print(server.server_address[1], flush=True)
server.serve_forever()
