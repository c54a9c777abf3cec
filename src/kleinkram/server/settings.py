"""Settings of the server's processes, documented in the settings reference.

`environment.load_settings` reads them from the environment, once, when a process starts.
"""

import enum
import ipaddress
import re
import ssl
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import quote, urlsplit

import psycopg
from psycopg.conninfo import conninfo_to_dict
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PostgresDsn,
    SecretStr,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from kleinkram.contract.access import Right
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.names import Name, name_key
from kleinkram.contract.people import EmailAddress, EmailDomain
from kleinkram.environments.uv import PYPI, parse_index

# Bounds what becomes a period of Python or PostgreSQL, which have the largest ones, or a limit of a process.
_MAX_DAYS = 3650
_MAX_S = _MAX_DAYS * 86_400
_MAX_BYTES = 2**50
Seconds = Annotated[float, Field(gt=0, le=_MAX_S)]
PerMinute = Annotated[int, Field(ge=0)]

# The database refuses fewer: a mistake must not delete what happened last week.
MIN_AUDIT_DAYS = 30

# Zoom, column and row of a tile, in its address.
_TILE_PLACES = ("{z}", "{x}", "{y}")
_PLAIN_HOST = re.compile(r"([A-Za-z0-9.-]+|\[[0-9A-Fa-f:]+\])(:\d+)?")
_PLAIN_TILE = re.compile(r"[A-Za-z0-9:/?=&%@._~+,\[\]-]+")

Network = ipaddress.IPv4Network | ipaddress.IPv6Network


def _networks(text: object) -> object:
    if not isinstance(text, str):
        return text
    try:
        return tuple(ipaddress.ip_network(part.strip()) for part in text.split(",") if part.strip())
    except ValueError as error:
        raise ValueError(f"must be networks such as 10.0.0.0/8, separated by commas: {error}") from None


def _database_url(value: object, validate: ValidatorFunctionWrapHandler) -> PostgresDsn:
    try:
        url: PostgresDsn = validate(value)
        conninfo_to_dict(plain_dsn(url))
    except (ValidationError, psycopg.Error):  # libpq's message may contain the password
        raise ValueError(
            "must be an address such as postgresql://user@host/name, with libpq's parameters and %-encoded characters"
        ) from None
    return url


def _web_address(text: str) -> str:
    try:
        parts = urlsplit(text)
        is_address = parts.scheme in {"http", "https"} and parts.hostname is not None and parts.port != 0
    except ValueError:  # the port is no number, or out of range
        is_address = False
    if not is_address or parts.query or parts.fragment or parts.username is not None or " " in text:
        raise ValueError("must be an address such as https://host:8443, without user, query and fragment")
    return text


def _tiles_url(text: str) -> str:
    """Return the address of map tiles: its origin becomes a part of the content policy, so it must be plain."""
    tile = text
    for place in _TILE_PLACES:
        tile = tile.replace(place, "0", 1)
    try:
        parts = urlsplit(text)
        is_address = parts.scheme in {"http", "https"} and parts.port != 0 and _PLAIN_HOST.fullmatch(parts.netloc)
    except ValueError:  # the port is no number, or out of range
        is_address = None
    has_places = all(place in text for place in _TILE_PLACES)
    if not has_places or not is_address or not _PLAIN_TILE.fullmatch(tile):
        raise ValueError(
            "must be an address such as https://host/{z}/{x}/{y}.png, with each of {z}, {x} and {y} once, behind the "
            "host, and nothing else in braces"
        )
    return text


def _readable(path: Path) -> Path:
    try:
        with path.open("rb"):
            return path
    except OSError as error:
        # What is no absolute path may be the secret itself.
        shown = path if path.is_absolute() else "what it names (not an absolute path)"
        raise ValueError(f"{shown} cannot be read ({error.strerror})") from None


def _certificates(path: Path) -> Path:
    try:
        ssl.create_default_context(cafile=str(_readable(path)))
    except ssl.SSLError:
        raise ValueError(f"{path} holds no certificates in PEM format") from None
    return path


def _not_empty(secret: SecretStr) -> SecretStr:
    if not secret.get_secret_value():
        raise ValueError("is empty")
    return secret


Secret = Annotated[SecretStr, AfterValidator(_not_empty)]
DatabaseUrl = Annotated[PostgresDsn, WrapValidator(_database_url)]
WebAddress = Annotated[str, AfterValidator(_web_address)]
TilesUrl = Annotated[str, AfterValidator(_tiles_url)]
ReadableFile = Annotated[Path, AfterValidator(_readable)]
CertificateFile = Annotated[Path, AfterValidator(_certificates)]


def _separated(text: object) -> object:
    return tuple(part.strip() for part in text.split(",") if part.strip()) if isinstance(text, str) else text


def _package_index(text: str) -> str:
    parse_index(text)
    return text


class SmtpSecurity(str, enum.Enum):
    """How the connection to the mail server is encrypted."""

    starttls = "starttls"
    tls = "tls"
    none = "none"


class OpenTo(str, enum.Enum):
    """Who gets an account by signing in for the first time."""

    anybody = "anybody"  # everybody whom the provider knows
    trusted_domains = "trusted_domains"  # people with a verified address in `trusted_domains`
    invited = "invited"  # of those, people who were invited under that address


class OidcProvider(BaseModel):
    """An OpenID Connect provider. It is trusted to verify addresses in `trusted_domains`; `*` means every domain."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=r"^[a-z0-9-]{1,32}$")]
    title: Annotated[str, Field(min_length=1, max_length=64)]
    issuer: str
    client_id: Annotated[str, Field(min_length=1)]
    client_secret: Secret | None = None
    client_secret_file: ReadableFile | None = None
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

    @property
    def is_refreshable(self) -> bool:
        """Whether it grants refresh tokens that outlive the session there, and that require the client's secret."""
        has_secret = self.client_secret is not None or self.client_secret_file is not None
        return "offline_access" in self.scopes and has_secret and self.client_auth != "none"

    def trusts(self, domain: str) -> bool:
        """Return whether it is trusted to verify addresses in exactly this domain."""
        return "*" in self.trusted_domains or domain in self.trusted_domains


class Viewer(BaseModel):
    """An external page that shows a recording: `{url}` in its address stands for the quoted URL of the recording."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(min_length=1, max_length=64)]
    url: Annotated[str, Field(pattern=r"^https?://[^/\s{}]+/.*\{url\}")]

    @property
    def origin(self) -> str:
        """The origin that a browser sends to the store."""
        return origin_of(self.url)


# Who may create projects and groups: people in an affiliation group (everybody if there are none), or others.
Creators = Literal["affiliated", "everybody", "admins"]


class Affiliation(BaseModel):
    """A group of people with a verified address in one of its domains, and its right on new projects."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Name
    domains: Annotated[tuple[EmailDomain, ...], Field(min_length=1, max_length=100)]
    default_right: Right | None = None


class Settings(BaseSettings):
    """Settings of a server process. Names in the environment: `KLEINKRAM_` and the name in capitals."""

    # Errors do not contain the value: it may be a password.
    model_config = SettingsConfigDict(env_prefix="KLEINKRAM_", frozen=True, extra="ignore", hide_input_in_errors=True)

    database_url: DatabaseUrl = Field(
        repr=False, description="PostgreSQL URL of the serving role, which has no rights on the schema."
    )
    migration_database_url: DatabaseUrl | None = Field(
        default=None,
        repr=False,
        description="PostgreSQL URL of the role that owns the schema; for `migrate`, backups and `check`.",
    )
    database_password: Secret | None = Field(default=None, description="Password for `DATABASE_URL`, if that has none.")
    migration_database_password: Secret | None = Field(
        default=None, description="Password for `MIGRATION_DATABASE_URL`, if that has none."
    )
    serving_role: str = Field(
        default="kleinkram_serve",
        pattern=r"^[a-z_][a-z0-9_]*$",
        description="The role in `DATABASE_URL`; migrations grant rights to it.",
    )
    database_connections: int = Field(
        default=8,
        ge=2,
        le=200,
        description="Connections in the pool of a process. An API process opens 2 more, a worker 13 more.",
    )

    s3_internal_url: WebAddress = Field(description="URL of the store, as this server reaches it.")
    s3_public_url: WebAddress | None = Field(
        default=None,
        description="URL of the store, as clients reach it: part of every signature. Default: the internal URL.",
    )
    s3_bucket: str = Field(
        default="kleinkram",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{1,61}[A-Za-z0-9]$",
        description="The bucket; it must exist.",
    )
    s3_region: str = Field(default="us-east-1", pattern=r"^[A-Za-z0-9_-]+$", description="Region in signatures.")
    s3_access_key: str = Field(pattern=r"^\S+$", description="Access key that may read, write and list the bucket.")
    s3_secret_key: Secret = Field(description="Secret key of the access key.")
    s3_ca_file: CertificateFile | None = Field(
        default=None, description="Certificate of the store's certificate authority, if that is private."
    )
    s3_cors: Literal["set", "leave"] = Field(
        default="set",
        description="`set`: the API writes the bucket's CORS rules at start, for its own pages and the viewers; "
        "`leave`: you write them.",
    )
    store_id: str = Field(
        default="main",
        pattern=r"^[!-~]{1,64}$",
        description="Name of the bucket in the database. Do not change it after the first start, also not when the "
        "files move to another store.",
    )

    store_folder: Path | None = Field(
        default=None, description="A folder on the store's disk, if it is on this machine, to report free space."
    )
    store_capacity_bytes: int | None = Field(
        default=None,
        ge=1,
        le=_MAX_BYTES * 1024,
        description="Size of a store on another machine, to report free space.",
    )

    public_url: WebAddress = Field(
        default="http://127.0.0.1:8000", description="URL of this server, as clients reach it."
    )
    lab_name: str = Field(
        default="Kleinkram", min_length=1, max_length=64, description="Name of this server on its pages."
    )
    viewers: tuple[Viewer, ...] = Field(
        default=(Viewer(name="Foxglove", url="https://app.foxglove.dev/~/view?ds=remote-file&ds.url={url}"),),
        description="External pages that can open a recording by its URL: a JSON list of "
        '{"name": "Lichtblick", "url": "https://lichtblick.example/?ds=remote-file&ds.url={url}"}; `[]` for none.',
    )
    map_tiles_url: TilesUrl | None = Field(
        default=None,
        description="Address of the tiles of a map (Web Mercator, 256 pixels), such as "
        "`https://tiles.lab.example/{z}/{x}/{y}.png`. Browsers fetch them from there, and so tell that server where "
        "their users look. Every visitor can read it, also a key in it, without signing in: use a key that the tile "
        "server accepts for the pages of this server only. Default: none; maps have a plain grid.",
    )
    map_tiles_attribution: str | None = Field(
        default=None,
        min_length=1,
        max_length=200,
        description="Text beside the map that names the source of the tiles; needed for `MAP_TILES_URL`.",
    )
    map_tiles_max_zoom: int = Field(
        default=19, ge=0, le=24, description="The greatest zoom for which there are tiles; nearer, these are enlarged."
    )
    owner_token_file: ReadableFile | None = Field(
        default=None, description="File with the local owner's token, mode 0600; written by `klein up`."
    )
    oidc_providers: tuple[OidcProvider, ...] = Field(
        default=(), description="OpenID Connect providers: a JSON list (see the sign-in page)."
    )
    local_accounts: bool = Field(default=True, description="Whether people can sign in with an address and a password.")
    session_idle_s: Seconds = Field(
        default=14 * 86_400, description="Seconds without use after which a browser is signed out."
    )
    session_s: Seconds = Field(
        default=90 * 86_400, description="Seconds after sign-in after which a browser is signed out."
    )
    provider_session_days: int = Field(
        default=30,
        ge=0,
        le=_MAX_DAYS,
        description="Days after which browser sessions and tokens of `klein login` stop working, until the provider "
        "with which the person signed in confirms their account again; 0: never.",
    )
    provider_check_hours: float = Field(
        default=24,
        ge=0,
        le=_MAX_DAYS * 24,
        description="Hours between checks of an account at its provider by a refresh token, if its `scopes` have "
        "`offline_access`; 0: never.",
    )
    login_token_days: int = Field(
        default=90, ge=1, le=_MAX_DAYS, description="Lifetime of tokens from `klein login`, in days."
    )
    token_days_default: int = Field(default=90, ge=1, le=_MAX_DAYS, description="Default lifetime of tokens, in days.")
    token_days_max: int = Field(
        default=365,
        ge=0,
        le=_MAX_DAYS,
        description="Maximum lifetime of tokens, and default lifetime of runner tokens, in days; "
        "0: any lifetime, and tokens without an end.",
    )
    fresh_sign_in_s: Seconds = Field(
        default=900,
        description="Seconds after sign-in in which people may change passwords, second factors, sign-in methods "
        "(admins also those of others), and create tokens with the scope admin; then they sign in again.",
    )
    owner_link_s: Seconds = Field(
        default=900, description="Lifetime of sign-in links for the owner of `klein up`, in seconds."
    )
    invitation_s: Seconds = Field(default=7 * 86_400, description="Lifetime of invitations, in seconds.")
    reset_link_s: Seconds = Field(default=86_400, description="Lifetime of password reset links, in seconds.")

    trusted_proxies: Annotated[
        tuple[Network, ...],
        NoDecode,
        BeforeValidator(_networks),
        Field(description="Networks of proxies whose X-Forwarded-For and -Proto are trusted, separated by commas."),
    ] = ()
    drain_s: float = Field(
        default=5,
        ge=0,
        le=60,
        description="Seconds for which a stopping API process behind `TRUSTED_PROXIES` still serves: it is not ready, "
        "and its responses close their connections. Longer than proxies keep idle connections to it. systemd, Compose "
        "or Kubernetes must wait 15 s longer before they kill it.",
    )
    monitoring_networks: Annotated[
        tuple[Network, ...],
        NoDecode,
        BeforeValidator(_networks),
        Field(
            description="Networks that get reasons and warnings from /health/ready, separated by commas. "
            "Default: this machine."
        ),
    ] = (ipaddress.IPv4Network("127.0.0.0/8"), ipaddress.IPv6Network("::1/128"))
    metrics_port: int | None = Field(
        default=None,
        ge=0,
        le=65535,
        description="Port for Prometheus metrics, a different one for each process; `--metrics-port` overrides it. "
        "Default: no metrics.",
    )
    metrics_address: str = Field(
        default="127.0.0.1",
        pattern=r"^[A-Za-z0-9.:-]+$",
        description="Address for metrics. They have no access control: use a private network.",
    )
    report_to: Annotated[
        tuple[EmailAddress, ...],
        NoDecode,
        BeforeValidator(_separated),
        Field(description="Addresses that get the status of the server by mail every Monday, separated by commas."),
    ] = ()
    smtp_host: str | None = Field(
        default=None, pattern=r"^[A-Za-z0-9.:-]+$", description="Mail server; needed for `REPORT_TO`."
    )
    smtp_port: int = Field(default=587, ge=1, le=65535, description="Port of the mail server.")
    smtp_security: SmtpSecurity = Field(
        default=SmtpSecurity.starttls,
        description="`starttls` (usually port 587), `tls` (usually 465), or `none` for a mail server on this machine.",
    )
    smtp_user: str | None = Field(default=None, min_length=1, description="User at the mail server. Default: none.")
    smtp_password: Secret | None = Field(default=None, description="Password of that user.")
    smtp_ca_file: CertificateFile | None = Field(
        default=None, description="Certificate of the mail server's certificate authority, if that is private."
    )
    mail_from: EmailAddress | None = Field(
        default=None, description="Address from which mail is sent; needed for `REPORT_TO`."
    )
    log_format: Literal["json", "text"] = Field(default="json", description="Format of log lines.")
    log_level: Literal["debug", "info", "warning"] = Field(
        default="info",
        description="Lowest level of log lines; `debug` adds the starts of jobs and the ends of periodic ones.",
    )

    affiliations: tuple[Affiliation, ...] = Field(
        default=(),
        description="Groups of people with a verified address in exactly these domains: a JSON list of "
        '{"name": "Lab", "domains": ["lab.example"], "default_right": "READ"}; the right is for new projects.',
    )
    creators: Creators = Field(
        default="affiliated",
        description="Who may create projects and groups: `affiliated` people (everybody if there are no "
        "affiliations), `everybody` or `admins`.",
    )
    weakest_isolation: Isolation = Field(
        default=Isolation.namespaces,
        description="The weakest isolation of runs that owners of projects may allow: `container`, `namespaces` or "
        "`none`. While a single person has an account, all are allowed.",
    )

    package_index: Annotated[str, AfterValidator(_package_index)] = Field(
        default=PYPI,
        repr=False,
        description="Where dependencies of scripts come from: `pypi`, the URL of an index, the absolute path of a "
        "folder of wheels, or `off`: then images must have them. The runner of `klein up` reads it, too.",
    )
    body_limit_bytes: int = Field(
        default=4 * 1024 * 1024,
        ge=65_536,
        description="Maximum size of a request body. Reports of runs and of checks may have 32 MiB.",
    )
    connections_per_address: int = Field(
        default=512,
        ge=16,
        description="Maximum connections of an address to one API process; trusted proxies have no limit.",
    )
    sign_ins_per_minute: PerMinute = Field(
        default=10,
        description="Sign-in attempts per address; an account's are delayed above three times as many; 0: no limit.",
    )
    searches_per_minute: PerMinute = Field(
        default=300, description="Searches and statistics per token, session or link; 0: no limit."
    )
    downloads_per_minute: PerMinute = Field(
        default=600, description="Download requests (of up to 500 files) per token, session or link; 0: no limit."
    )
    uploads_per_minute: PerMinute = Field(
        default=600, description="Upload requests per token, session or link; 0: no limit."
    )
    verifications_per_minute: PerMinute = Field(
        default=600, description="Verification requests for files per token, session or link; 0: no limit."
    )
    exports_per_minute: PerMinute = Field(
        default=6, description="Exports of the audit log and of people's data per token, session or link; 0: no limit."
    )
    upload_lease_s: Seconds = Field(
        default=60, description="Seconds for which an upload reserves its name after the last part was signed."
    )
    upload_expires_s: Seconds = Field(
        default=7 * 86_400, description="Seconds after which an unfinished upload expires."
    )
    part_url_s: Seconds = Field(default=900, description="Lifetime of upload URLs of parts, in seconds.")
    download_url_s: Seconds = Field(default=900, description="Lifetime of download URLs, in seconds.")
    slices_at_once: int = Field(
        default=4, ge=1, description="Slices of recordings that one API process makes at once, each in a child process."
    )
    slices_per_account: int = Field(
        default=2, ge=1, description="Of these, slices of one account, link, or address without an account."
    )
    slice_timeout_s: int = Field(
        default=900, ge=1, le=_MAX_S, description="Seconds, also of processor time, after which a slice is cut off."
    )
    slice_memory_bytes: int = Field(
        default=1024 * 1024 * 1024,
        ge=256 * 1024 * 1024,
        le=_MAX_BYTES,
        description="Address space of the process that makes a slice.",
    )
    share_days_max: int = Field(default=90, ge=1, le=_MAX_DAYS, description="Maximum lifetime of share links, in days.")
    trash_days: int = Field(
        default=30, ge=0, le=_MAX_DAYS, description="Days for which deleted objects can be restored."
    )
    audit_days: int = Field(
        default=0,
        ge=0,
        le=_MAX_DAYS,
        description="Days for which events of the audit log are kept, at least 30; 0: forever. `migrate` applies it.",
    )
    audit_archive: Path | None = Field(
        default=None,
        description="A folder to which the worker writes events of the audit log before they are deleted. "
        "Default: they are not kept.",
    )
    garbage_grace_s: float = Field(
        default=3600,
        ge=0,
        le=_MAX_S,
        description="Seconds between marking an unreferenced blob for deletion and deleting its object.",
    )
    verify_bytes_per_s: int = Field(
        default=100_000_000,
        ge=1_048_576,
        description="Rate at which one worker process reads blobs to verify them, in bytes per second.",
    )
    reverify_days: int = Field(
        default=90, ge=0, le=_MAX_DAYS, description="Days after which a verified blob is verified again; 0: never."
    )
    scrub_hours: float = Field(
        default=24,
        ge=0,
        le=_MAX_DAYS * 24,
        description="Hours between scrubs, which compare the store's list with the database; 0: only on request.",
    )
    summary_memory_bytes: int = Field(
        default=1024**3,
        ge=128 * 1024**2,
        le=_MAX_BYTES,
        description="Address space of the child process that reads recordings.",
    )
    summary_timeout_s: Seconds = Field(default=300, description="Maximum seconds for the summary of one recording.")
    recording_previews: bool = Field(
        default=True,
        description="Whether the worker makes previews of recordings above 100 kB. If off, only on request.",
    )

    @field_validator("audit_days")
    @classmethod
    def _is_not_short(cls, days: int) -> int:
        if 0 < days < MIN_AUDIT_DAYS:
            raise ValueError(f"must be 0, or at least {MIN_AUDIT_DAYS}")
        return days

    @model_validator(mode="before")
    @classmethod
    def _with_passwords(cls, values: dict[str, object]) -> dict[str, object]:
        urls = {
            f"{purpose}_url": _with_password(str(values[f"{purpose}_url"]), values, f"{purpose}_password")
            for purpose in ("database", "migration_database")
            if values.get(f"{purpose}_url") is not None
        }
        return {**values, **urls}

    @field_validator("oidc_providers")
    @classmethod
    def _are_distinct(cls, providers: tuple[OidcProvider, ...]) -> tuple[OidcProvider, ...]:
        for field in ("name", "issuer"):
            if len({getattr(provider, field) for provider in providers}) < len(providers):
                raise ValueError(f"two providers have the same {field}")
        return providers

    @field_validator("affiliations")
    @classmethod
    def _have_one_name_each(cls, affiliations: tuple[Affiliation, ...]) -> tuple[Affiliation, ...]:
        if len({name_key(affiliation.name) for affiliation in affiliations}) < len(affiliations):
            raise ValueError("two affiliations have the same name")
        return affiliations

    @model_validator(mode="after")
    def _can_send_reports(self) -> "Settings":
        if self.report_to and (self.smtp_host is None or self.mail_from is None):
            raise ValueError("KLEINKRAM_REPORT_TO needs KLEINKRAM_SMTP_HOST and KLEINKRAM_MAIL_FROM")
        if (self.smtp_user is None) != (self.smtp_password is None):
            raise ValueError("KLEINKRAM_SMTP_USER and KLEINKRAM_SMTP_PASSWORD belong together")
        if self.smtp_user is not None and self.smtp_security is SmtpSecurity.none:
            raise ValueError("KLEINKRAM_SMTP_PASSWORD is not sent without encryption: set KLEINKRAM_SMTP_SECURITY")
        return self

    @model_validator(mode="after")
    def _names_the_source_of_tiles(self) -> "Settings":
        if self.map_tiles_url is not None and self.map_tiles_attribution is None:
            raise ValueError("KLEINKRAM_MAP_TILES_URL needs KLEINKRAM_MAP_TILES_ATTRIBUTION")
        return self

    @property
    def public_origin(self) -> str:
        """The origin of this server's pages, as browsers name it."""
        return origin_of(self.public_url)

    @property
    def store_origin(self) -> str:
        """The origin of the store's public URL, which pages must be allowed to access."""
        return origin_of(self.store_public_url)

    @property
    def tiles_origin(self) -> str | None:
        """The origin of map tiles, from which pages must be allowed to load images; None without tiles."""
        return None if self.map_tiles_url is None else origin_of(self.map_tiles_url)

    @property
    def store_public_url(self) -> str:
        """The URL of the store in signatures for clients."""
        return self.s3_public_url or self.s3_internal_url


# URLs and structures that contain passwords; every SecretStr is a secret, too.
_SECRET = frozenset({"database_url", "migration_database_url", "s3_access_key", "oidc_providers", "package_index"})


def is_secret(name: str) -> bool:
    """Return whether the value of a setting is a secret: never shown, and readable from a file."""
    return name in _SECRET or "SecretStr" in str(Settings.model_fields[name].annotation)


def _with_password(url: str, values: dict[str, object], name: str) -> str:
    """Return a database URL with the password of that name, if there is one."""
    password = values.get(name)
    secret = password.get_secret_value() if isinstance(password, SecretStr) else password
    if not secret:
        return url
    scheme, _, rest = url.partition("://")
    userinfo, at, host = rest.partition("@")
    if not at or ":" in userinfo:
        raise ValueError(
            f"KLEINKRAM_{name.upper()} needs a database URL with a user and no password: postgresql://user@host/name"
        )
    return f"{scheme}://{userinfo}:{quote(str(secret), safe='')}@{host}"


def origin_of(url: str) -> str:
    """Return the origin of an address as browsers write it: in lower case, without the default port."""
    parts = urlsplit(url)
    scheme, host = parts.scheme.lower(), parts.hostname or ""
    host = f"[{host}]" if ":" in host else host
    is_usual = parts.port in {None, {"http": 80, "https": 443}.get(scheme)}
    return f"{scheme}://{host}" if is_usual else f"{scheme}://{host}:{parts.port}"


def async_dsn(url: PostgresDsn) -> str:
    """Return a database URL for SQLAlchemy, with the psycopg driver."""
    return f"postgresql+psycopg://{str(url).split('://', 1)[1]}"


def plain_dsn(url: PostgresDsn) -> str:
    """Return a database URL for libpq."""
    return f"postgresql://{str(url).split('://', 1)[1]}"
