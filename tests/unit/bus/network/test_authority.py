import datetime
import stat
from pathlib import Path

import pytest
from cryptography import x509

from crazychoir.bus.network import authority
from crazychoir.bus.network.authority import (
    KEY_FILES,
    add_host,
    certified_hosts,
    check_keys,
    make_authority,
    revoke_host,
)
from crazychoir.errors import ConfigError


@pytest.fixture
def keys(tmp_path):
    folder = tmp_path / "keys"
    make_authority(folder)
    for host in ("laptop", "desktop"):
        add_host(folder, host)
    return folder


def read(folder):
    return x509.load_pem_x509_certificate((folder / KEY_FILES.certificate).read_bytes())


def test_an_authority_signs_a_certificate_for_each_host(keys):
    assert [holder.name for holder in certified_hosts(keys)] == ["desktop", "laptop"]
    assert check_keys(keys, "laptop") == keys / "laptop"
    certificate, root = read(keys / "laptop"), read(keys / KEY_FILES.authority_folder)
    certificate.verify_directly_issued_by(root)
    assert certificate.subject.rfc4514_string() == "CN=laptop"
    assert certificate.not_valid_after_utc <= root.not_valid_after_utc
    constraints = certificate.extensions.get_extension_for_class(
        x509.BasicConstraints
    ).value
    assert not constraints.ca, "a host makes no hosts"


def test_no_certificate_is_good_for_longer_than_its_authority(tmp_path):
    make_authority(tmp_path, days=10)
    add_host(tmp_path, "laptop", days=300)
    assert (
        read(tmp_path / "laptop").not_valid_after_utc
        == read(tmp_path / KEY_FILES.authority_folder).not_valid_after_utc
    )


def test_keys_are_read_by_their_owner_alone(keys):
    for name in (KEY_FILES.authority_folder, "laptop"):
        assert stat.S_IMODE((keys / name).stat().st_mode) == 0o700
        assert (
            stat.S_IMODE((keys / name / KEY_FILES.private_key).stat().st_mode) == 0o600
        )
    assert not (keys / "laptop" / KEY_FILES.authority_folder).exists(), (
        "what makes certificates stays where it is"
    )


def test_a_revoked_host_holds_a_certificate_of_a_discarded_authority(keys):
    before, root = read(keys / "desktop"), read(keys / KEY_FILES.authority_folder)
    assert revoke_host(keys, "laptop") == ["desktop"]
    assert [holder.name for holder in certified_hosts(keys)] == ["desktop"]
    assert read(keys / KEY_FILES.authority_folder) != root
    assert read(keys / "desktop") != before
    with pytest.raises(ValueError, match=r"(?i)issuer|signature"):
        before.verify_directly_issued_by(read(keys / KEY_FILES.authority_folder))
    assert check_keys(keys, "desktop")
    assert sorted(path.name for path in keys.parent.iterdir()) == ["keys"], (
        "nothing is left over"
    )


def test_what_cannot_be_is_refused_and_changes_nothing(keys, tmp_path):
    for work, says in (
        (lambda: make_authority(keys), "it is not replaced"),
        (lambda: add_host(keys, "laptop"), "crazychoir keys revoke laptop"),
        (lambda: add_host(keys, "../laptop"), "1 to 40 of a-z"),
        (lambda: add_host(keys, KEY_FILES.authority_folder), "but not authority"),
        (lambda: revoke_host(keys, "tower"), "desktop, laptop"),
        (lambda: add_host(tmp_path / "none", "laptop"), "crazychoir keys init"),
        (lambda: certified_hosts(tmp_path / "none"), "crazychoir keys init"),
    ):
        with pytest.raises(ConfigError, match=says):
            work()
    assert [holder.name for holder in certified_hosts(keys)] == ["desktop", "laptop"]
    assert not (tmp_path / "none").exists()


def test_an_authority_that_has_expired_gives_nothing_and_says_what_to_do(
    tmp_path, monkeypatch
):
    keys, now = tmp_path / "keys", authority.date_and_time()
    monkeypatch.setattr(
        authority, "date_and_time", lambda: now - datetime.timedelta(days=2)
    )
    make_authority(keys, days=1)
    add_host(keys, "laptop", days=1)
    monkeypatch.undo()
    with pytest.raises(
        ConfigError,
        match=r"it has expired.*Remove .*keys, then make all anew: crazychoir keys init",
    ):
        add_host(keys, "desktop")
    assert not (keys / "desktop").exists()
    assert [holder.name for holder in certified_hosts(keys)] == ["laptop"]
    assert revoke_host(keys, "laptop") == []
    assert add_host(keys, "desktop"), "of the new authority"


def test_keys_are_made_anew_in_this_folder_and_behind_a_link(
    keys, tmp_path, monkeypatch
):
    monkeypatch.chdir(keys)
    assert revoke_host(Path(), "laptop") == ["desktop"]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").symlink_to(keys)
    assert revoke_host(tmp_path / "elsewhere", "desktop") == []
    assert (tmp_path / "elsewhere").is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere", "keys"]


def other_authority(keys):
    (keys / "laptop" / KEY_FILES.authority_certificate).write_bytes(
        (make_authority(keys.parent / "others")).read_bytes()
    )


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (
            lambda keys: (keys / "laptop" / KEY_FILES.certificate).unlink(),
            "keys add laptop",
        ),
        (
            lambda keys: (keys / "laptop" / KEY_FILES.certificate).write_text(
                "nothing"
            ),
            "a certificate in PEM",
        ),
        (
            lambda keys: (keys / "laptop" / KEY_FILES.private_key).unlink(),
            "the private key of its certificate",
        ),
        (
            lambda keys: (keys / "desktop" / KEY_FILES.private_key).replace(
                keys / "laptop" / KEY_FILES.private_key
            ),
            "another certificate",
        ),
        (
            lambda keys: (keys / "laptop" / KEY_FILES.private_key).chmod(0o644),
            "chmod 600",
        ),
        (
            lambda keys: (keys / "desktop").rename(keys / "tower"),
            "that of desktop; allowed: that of tower",
        ),
        (other_authority, "signed by another authority"),
    ],
)
def test_keys_that_are_not_good_are_refused_before_anything_is_opened(keys, harm, says):
    harm(keys)
    with pytest.raises(ConfigError, match=says):
        check_keys(keys, "tower" if (keys / "tower").exists() else "laptop")


@pytest.mark.parametrize("days", [-1, 10_000])
def test_a_certificate_is_good_for_a_while(keys, days):
    now = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=days)
    with pytest.raises(ConfigError, match=r"good from .* Set the clock of this host"):
        check_keys(keys, "laptop", now)
