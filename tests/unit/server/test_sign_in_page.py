"""The settings on docs/sign-in.md exist."""

import json
import re
from pathlib import Path

from pydantic import TypeAdapter

from kleinkram.server.settings import Affiliation, OidcProvider, OpenTo

DOCS = Path(__file__).parents[3] / "docs"
SIGN_IN = (DOCS / "sign-in.md").read_text()


def example(page: str, variable: str) -> str:
    result = re.search(rf"export {variable}='(.*?)'", page, re.DOTALL)
    assert result is not None
    return result[1]


def test_the_provider_of_the_documentation_is_valid(tmp_path: Path) -> None:
    (fields,) = json.loads(example(SIGN_IN, "KLEINKRAM_OIDC_PROVIDERS"))
    secret = tmp_path / Path(fields["client_secret_file"]).name
    secret.write_text("a secret of the provider")
    provider = OidcProvider.model_validate({**fields, "client_secret_file": str(secret)})
    assert f"/sign-in/callback/{provider.name}`" in SIGN_IN, "the redirect URI has the provider's name"
    assert provider.trusts("lab.example")
    assert not provider.trusts("students.lab.example")


def test_the_documentation_names_exactly_the_fields_of_a_provider() -> None:
    answer = SIGN_IN.partition("All fields of a provider:")[2].partition("Several providers")[0]
    names = set(re.findall(r"`([a-z_]+)`", answer)) - {"client_secret_basic", "client_secret_post", "none"}
    assert names == set(OidcProvider.model_fields)
    assert all(f"`{way.value}`" in SIGN_IN for way in OpenTo)


def test_every_documented_issuer_is_valid() -> None:
    table = SIGN_IN.partition("| provider | `issuer`")[2].partition("\n\n")[0]
    issuers = re.findall(r"`(https://[^`]+)`", table)
    assert len(issuers) >= 7
    for issuer in issuers:
        fields = {"name": "x", "title": "X", "issuer": issuer, "client_id": "kleinkram"}
        assert OidcProvider.model_validate(fields).issuer == issuer


def test_the_documented_affiliations_are_valid() -> None:
    text = example((DOCS / "access.md").read_text(), "KLEINKRAM_AFFILIATIONS")
    (affiliation,) = TypeAdapter(tuple[Affiliation, ...]).validate_python(json.loads(text))
    assert affiliation.domains == ("lab.example",)
