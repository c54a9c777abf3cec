"""Settings of the server's processes. Every one is described in the settings reference.

`environment.load_settings` reads them from the environment, once, when a process starts.
"""

import enum
import ipaddress
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import quote, urlsplit

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PostgresDsn,
    SecretStr,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from kleinkram.contract.emails import EmailDomain
from kleinkram.contract.names import Name, name_key
from kleinkram.contract.rights import Right

Seconds = Annotated[float, Field(gt=0)]
PerMinute = Annotated[int, Field(ge=0)]


Network = ipaddress.IPv4Network | ipaddress.IPv6Network


def _networks(text: object) -> object:
    if not isinstance(text, str):
        return text
    return tuple(ipaddress.ip_network(part.strip()) for part in text.split(",") if part.strip())


class OpenTo(str, enum.Enum):
    """Who gets an account by signing in for the first time."""

    anybody = "anybody"  # whoever the provider knows
    trusted_domains = "trusted_domains"  # whoever has a verified address of a domain that the provider is trusted for
    invited = "invited"  # of those, whoever was invited under that address


class OidcProvider(BaseModel):
    """One OpenID Connect provider. Its word on an address counts for `trusted_domains` alone; `*` is every domain."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=r"^[a-z0-9-]{1,32}$")]
    title: Annotated[str, Field(min_length=1, max_length=64)]
    issuer: str
    client_id: Annotated[str, Field(min_length=1)]
    client_secret: SecretStr | None = None
    client_secret_file: Path | None = None
    client_auth: Literal["client_secret_basic", "client_secret_post", "none"] = "client_secret_basic"
    scopes: tuple[str, ...] = ("openid", "profile", "email")
    trusted_domains: tuple[EmailDomain | Literal["*"], ...] = ()
    open_to: OpenTo = OpenTo.trusted_domains
    timeout_s: Seconds = 10

    @field_validator("issuer")
    @classmethod
    def _is_safe(cls, issuer: str) -> str:
        parts = urlsplit(issuer)
        is_near = parts.scheme == "http" and parts.hostname in {"127.0.0.1", "localhost", "::1"}
        if not (parts.scheme == "https" or is_near) or not parts.hostname or parts.query or parts.fragment:
            raise ValueError("must be an https address (http only on this machine), without query and fragment")
        return issuer

    def trusts(self, domain: str) -> bool:
        """Say whether its word on addresses of exactly this domain counts."""
        return "*" in self.trusted_domains or domain in self.trusted_domains


class Viewer(BaseModel):
    """A page elsewhere that shows a recording: `{url}` in its own address stands for the recording's, quoted."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(min_length=1, max_length=64)]
    url: Annotated[str, Field(pattern=r"^https?://[^/\s{}]+/.*\{url\}")]

    @property
    def origin(self) -> str:
        """As whom the browser introduces it to the store."""
        return origin_of(self.url)


# Who may make projects and groups: people of an affiliation group (everybody, where none is configured), or others.
Creators = Literal["affiliated", "everybody", "admins"]


class Affiliation(BaseModel):
    """A group of whoever has a verified address of exactly one of some domains, and what it gets on new projects."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Name
    domains: Annotated[tuple[EmailDomain, ...], Field(min_length=1, max_length=100)]
    default_right: Right | None = None


class Settings(BaseSettings):
    """What one server process needs to know. Names in the environment: `KLEINKRAM_` and the name in capitals."""

    # What is wrong is said without what was given: it may be a password.
    model_config = SettingsConfigDict(env_prefix="KLEINKRAM_", frozen=True, extra="ignore", hide_input_in_errors=True)

    database_url: Annotated[
        PostgresDsn, Field(repr=False, description="PostgreSQL as the role that serves; no rights on the schema.")
    ]
    migration_database_url: Annotated[
        PostgresDsn | None,
        Field(repr=False, description="PostgreSQL as the role that owns the schema; only `migrate` needs it."),
    ] = None
    database_password: Annotated[
        SecretStr | None, Field(description="Password for `DATABASE_URL`, where the address has none.")
    ] = None
    migration_database_password: Annotated[
        SecretStr | None, Field(description="Password for `MIGRATION_DATABASE_URL`, where the address has none.")
    ] = None
    serving_role: Annotated[
        str, Field(pattern=r"^[a-z_][a-z0-9_]*$", description="The role in `database_url`, which migrations grant to.")
    ] = "kleinkram_serve"
    database_connections: Annotated[
        int,
        Field(
            ge=2,
            le=200,
            description="Connections in a process's pool; beside it, an API process opens 2 more, a worker 13.",
        ),
    ] = 8

    s3_internal_url: Annotated[str, Field(description="The store's address as this server reaches it.")]
    s3_public_url: Annotated[
        str | None,
        Field(
            description="The store's address as clients reach it: part of every signature. Default: the internal one."
        ),
    ] = None
    s3_bucket: Annotated[str, Field(min_length=3, description="The bucket; it must exist.")] = "kleinkram"
    s3_region: Annotated[str, Field(description="The region that signatures name.")] = "us-east-1"
    s3_access_key: Annotated[
        str, Field(description="Access key of an identity that may read, write and list the bucket.")
    ]
    s3_secret_key: Annotated[SecretStr, Field(description="Its secret key.")]
    s3_ca_file: Annotated[
        Path | None, Field(description="Certificate authority of the store, where it is a private one.")
    ] = None
    s3_cors: Annotated[
        Literal["set", "leave"],
        Field(
            description="Whether the API, when it starts, writes the bucket's CORS rules, so that its pages (and the "
            "viewers) may send and fetch; `leave` where somebody else writes them."
        ),
    ] = "set"
    store_id: Annotated[
        str,
        Field(
            description="The name by which the database refers to the bucket. There is one bucket: after the first "
            "start, never change this, also not when the files move to another store."
        ),
    ] = "main"

    store_folder: Annotated[
        Path | None,
        Field(description="A folder on the store's disk where that is this machine's, for telling how full it is."),
    ] = None

    public_url: Annotated[str, Field(description="This server's address as clients reach it.")] = (
        "http://127.0.0.1:8000"
    )
    lab_name: Annotated[str, Field(min_length=1, max_length=64, description="What the pages call this server.")] = (
        "Kleinkram"
    )
    viewers: Annotated[
        tuple[Viewer, ...],
        Field(
            description="Pages elsewhere that open a recording by its address, which they then learn: a JSON list of "
            '{"name": "Lichtblick", "url": "https://lichtblick.example/?ds=remote-file&ds.url={url}"}; `[]` for none.'
        ),
    ] = (Viewer(name="Foxglove", url="https://app.foxglove.dev/~/view?ds=remote-file&ds.url={url}"),)
    owner_token_file: Annotated[
        Path | None, Field(description="File with the local owner's token; made by `klein up`, mode 0600.")
    ] = None
    oidc_providers: Annotated[
        tuple[OidcProvider, ...],
        Field(description="Who says who people are: a JSON list of OpenID Connect providers (see the sign-in page)."),
    ] = ()
    local_accounts: Annotated[bool, Field(description="Whether one may sign in with an address and a password.")] = True
    session_idle_s: Annotated[Seconds, Field(description="After how long unused a browser is signed out.")] = (
        14 * 86_400
    )
    session_s: Annotated[Seconds, Field(description="After how long it is signed out in any case.")] = 90 * 86_400
    login_token_days: Annotated[
        int, Field(ge=1, le=3650, description="How long a token that `klein login` gets is good for.")
    ] = 90
    token_days_default: Annotated[
        int, Field(ge=1, le=3650, description="How long a token is good for that is made without an end.")
    ] = 90
    token_days_max: Annotated[
        int,
        Field(
            ge=0,
            le=3650,
            description="How long a token may be good at most, and how long a runner's is by default; "
            "0: any time, and for ever if that is asked for.",
        ),
    ] = 365
    fresh_sign_in_s: Annotated[
        Seconds,
        Field(
            description="How long after signing in one may change passwords, second factors and ways to sign in "
            "(admins also those of others), and make tokens with the scope admin, before one is asked to sign in again."
        ),
    ] = 900
    owner_link_s: Annotated[
        Seconds, Field(description="How long the link is good by which the owner of `klein up` signs in.")
    ] = 900
    invitation_s: Annotated[Seconds, Field(description="How long an invitation is good.")] = 7 * 86_400
    reset_link_s: Annotated[Seconds, Field(description="How long a link to a new password is good.")] = 86_400

    trusted_proxies: Annotated[
        tuple[Network, ...],
        NoDecode,
        BeforeValidator(_networks),
        Field(
            description="Networks, with commas between, whose X-Forwarded-For and -Proto are believed. Default: none."
        ),
    ] = ()
    watcher_networks: Annotated[
        tuple[Network, ...],
        NoDecode,
        BeforeValidator(_networks),
        Field(
            description="Networks, with commas between, to which /health/ready gives its reasons. "
            "Default: this machine."
        ),
    ] = (ipaddress.IPv4Network("127.0.0.0/8"), ipaddress.IPv6Network("::1/128"))
    metrics_port: Annotated[
        int | None,
        Field(
            ge=0,
            le=65535,
            description="Port on which a process serves its Prometheus metrics, one of its own for each process; "
            "`--metrics-port` overrides it. Default: metrics are not served.",
        ),
    ] = None
    metrics_address: Annotated[
        str,
        Field(
            description="Address on which metrics are served. Whoever reaches it can read them: keep it on this "
            "machine or in a private network."
        ),
    ] = "127.0.0.1"
    log_format: Annotated[Literal["json", "text"], Field(description="How log lines look.")] = "json"

    affiliations: Annotated[
        tuple[Affiliation, ...],
        Field(
            description="Groups filled by the exact domains of verified addresses: a JSON list of "
            '{"name": "Lab", "domains": ["lab.example"], "default_right": "READ"}; the right is given on new projects.'
        ),
    ] = ()
    creators: Annotated[
        Creators,
        Field(
            description="Who may make projects and groups: `affiliated` people (everybody, where there are no "
            "affiliations), `everybody` or `admins`."
        ),
    ] = "affiliated"

    body_limit_bytes: Annotated[int, Field(ge=65_536, description="Largest request body.")] = 4 * 1024 * 1024
    connections_per_address: Annotated[
        int,
        Field(
            ge=16,
            description="Connections that one address may have open with one API process; trusted proxies may have any "
            "number.",
        ),
    ] = 512
    sign_ins_per_minute: Annotated[
        PerMinute,
        Field(description="Tries to sign in from one address; beyond three times as many an account's wait; 0: any."),
    ] = 10
    searches_per_minute: Annotated[
        PerMinute,
        Field(description="Searches by text or topic, and statistics, for one token, session or link; 0: any number."),
    ] = 300
    downloads_per_minute: Annotated[
        PerMinute, Field(description="Requests for addresses of files to fetch (500 each), likewise.")
    ] = 600
    uploads_per_minute: Annotated[PerMinute, Field(description="Requests that announce files to send, likewise.")] = 600
    verifications_per_minute: Annotated[PerMinute, Field(description="Files to verify again, likewise.")] = 600
    exports_per_minute: Annotated[PerMinute, Field(description="Exports of the record, likewise.")] = 6
    upload_lease_s: Annotated[
        Seconds, Field(description="How long a name stays held after the last part was signed.")
    ] = 60
    upload_expires_s: Annotated[Seconds, Field(description="How long an unfinished upload is kept.")] = 7 * 86_400
    part_url_s: Annotated[Seconds, Field(description="How long the address of a part to send is good for.")] = 900
    download_url_s: Annotated[Seconds, Field(description="How long the address of a file to fetch is good for.")] = 900
    share_days_max: Annotated[int, Field(ge=1, le=3650, description="How long a link may be good at most.")] = 90
    trash_days: Annotated[int, Field(ge=0, description="How long deleted things can be had back.")] = 30
    sweep_grace_s: Annotated[
        float, Field(ge=0, description="Between dooming an unreferenced blob and deleting its object.")
    ] = 3600
    verify_bytes_per_s: Annotated[
        int, Field(ge=1_048_576, description="How fast one worker process reads new blobs to verify them.")
    ] = 100_000_000
    reverify_days: Annotated[
        int, Field(ge=0, description="After how many days a verified blob is read and compared again; 0: never.")
    ] = 90
    scrub_hours: Annotated[
        float,
        Field(
            ge=0, description="How often the store's list is compared with the database, in hours; 0: only when asked."
        ),
    ] = 24
    summary_memory_bytes: Annotated[
        int, Field(ge=128 * 1024**2, description="Address space of the process that reads untrusted recordings.")
    ] = 1024**3
    summary_timeout_s: Annotated[Seconds, Field(description="How long reading one recording's summary may take.")] = 300

    @model_validator(mode="before")
    @classmethod
    def _with_passwords(cls, values: dict[str, object]) -> dict[str, object]:
        urls = {
            name: _with_password(str(values[name]), values.get(name.replace("url", "password")))
            for name in ("database_url", "migration_database_url")
            if values.get(name) is not None
        }
        return {**values, **urls}

    @field_validator("oidc_providers")
    @classmethod
    def _are_told_apart(cls, providers: tuple[OidcProvider, ...]) -> tuple[OidcProvider, ...]:
        for each in ("name", "issuer"):
            if len({getattr(provider, each) for provider in providers}) < len(providers):
                raise ValueError(f"two providers have the same {each}")
        return providers

    @field_validator("affiliations")
    @classmethod
    def _have_one_name_each(cls, affiliations: tuple[Affiliation, ...]) -> tuple[Affiliation, ...]:
        if len({name_key(each.name) for each in affiliations}) < len(affiliations):
            raise ValueError("two affiliations have the same name")
        return affiliations

    @property
    def public_origin(self) -> str:
        """The origin of this server's pages, as browsers name it."""
        return origin_of(self.public_url)

    @property
    def store_origin(self) -> str:
        """The origin of the store's public address: whom pages must be allowed to talk to."""
        return origin_of(self.store_public_url)

    @property
    def store_public_url(self) -> str:
        """The address that clients' signatures name."""
        return self.s3_public_url or self.s3_internal_url


# Addresses with passwords in them, and what holds secrets further inside; and every setting that is a SecretStr.
_SECRET = frozenset({"database_url", "migration_database_url", "s3_access_key", "oidc_providers"})


def is_secret(name: str) -> bool:
    """Say of a setting whether its value is a secret: never shown, and readable from a file."""
    return name in _SECRET or "SecretStr" in str(Settings.model_fields[name].annotation)


def _with_password(url: str, password: object) -> str:
    """Return a database address with a password put into it, unless none is given."""
    secret = password.get_secret_value() if isinstance(password, SecretStr) else password
    if not secret:
        return url
    scheme, _, rest = url.partition("://")
    userinfo, at, place = rest.partition("@")
    if not at or ":" in userinfo:
        raise ValueError(
            "a database password needs an address with a user and no password: postgresql://user@host/name"
        )
    return f"{scheme}://{userinfo}:{quote(str(secret), safe='')}@{place}"


def origin_of(url: str) -> str:
    """Return the origin of an address as browsers write it: in small letters, without the usual port."""
    parts = urlsplit(url)
    scheme, host = parts.scheme.lower(), parts.hostname or ""
    host = f"[{host}]" if ":" in host else host
    is_usual = parts.port in {None, {"http": 80, "https": 443}.get(scheme)}
    return f"{scheme}://{host}" if is_usual else f"{scheme}://{host}:{parts.port}"


def async_dsn(url: PostgresDsn) -> str:
    """Return a database address as SQLAlchemy wants it, with the psycopg driver."""
    return f"postgresql+psycopg://{str(url).split('://', 1)[1]}"


def plain_dsn(url: PostgresDsn) -> str:
    """Return a database address as libpq wants it."""
    return f"postgresql://{str(url).split('://', 1)[1]}"
