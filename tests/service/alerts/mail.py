"""A mail server for tests: prints its port, then one JSON line a mail.

Arguments: certificate, key, plain|starttls|smtps, how many mails to refuse for now before taking the first.
"""
import asyncio
import email
import email.policy
import json
import ssl
import sys

from aiosmtpd.smtp import SMTP, AuthResult

certificate, key, mode, refused = sys.argv[1:]
refused = int(refused)
context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
context.load_cert_chain(certificate, key)


class Handler:
    async def handle_DATA(self, server, session, envelope):
        global refused
        mail = email.message_from_bytes(envelope.content, policy=email.policy.default)
        print(json.dumps({
            "taken": refused == 0,
            "recipients": envelope.rcpt_tos,
            "encrypted": session.ssl is not None or mode == "smtps",
            "authenticated": bool(session.authenticated),
            "from": mail["From"],
            "to": mail["To"],
            "subject": mail["Subject"],
            "id": mail["Message-ID"],
            "references": mail["References"],
            "body": mail.get_content().replace("\r\n", "\n"),
        }), flush=True)
        if refused > 0:
            refused -= 1
            return "451 later"
        return "250 taken"

    async def handle_RCPT(self, server, session, envelope, address, options):
        if address.startswith("nobody@"):
            return "550 no such user"
        envelope.rcpt_tos.append(address)
        return "250 fine"


def authenticate(server, session, envelope, mechanism, data):
    return AuthResult(handled=False, success=data.login == b"tirante" and data.password == b"secret")


def server():
    return SMTP(
        Handler(),
        hostname="localhost",
        tls_context=context if mode == "starttls" else None,
        require_starttls=mode == "starttls",
        authenticator=authenticate,
        auth_required=True,
        auth_require_tls=mode == "starttls",
    )


async def main():
    listening = await asyncio.get_running_loop().create_server(
        server, "127.0.0.1", 0, ssl=context if mode == "smtps" else None
    )
    print(listening.sockets[0].getsockname()[1], flush=True)
    await listening.serve_forever()


asyncio.run(main())
