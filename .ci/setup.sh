# Sourced: `. .ci/setup.sh`, from the root of the repository: uv on the path, a scratch folder, and `step`.
exec </dev/null
export PYTHONUNBUFFERED=1 UV_NO_PROGRESS=1

scratch="$(mktemp -d)"
trap 'rm -rf "$scratch"' EXIT
. .ci/uv.sh "$scratch"

step() { # COMMAND...: print it, run it, print its time
    local begun=$SECONDS
    printf '\n=== %s\n' "$*"
    "$@"
    printf -- '--- %d s\n' $((SECONDS - begun))
}

chromium() { # the browser of the tuner's tests, which are skipped where there is none
    if command -v chromium chromium-browser google-chrome >/dev/null || [ "$(id -u)" != 0 ]; then return; fi
    if ! command -v apt-get >/dev/null; then return; fi
    (apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium) \
        >/dev/null 2>&1 || echo "Chromium cannot be installed here: the tests of the tuner's page are skipped."
}
