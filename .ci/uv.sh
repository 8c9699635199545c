# Sourced: `. .ci/uv.sh FOLDER` puts uv on the path, through pip into FOLDER where there is none.
if ! command -v uv >/dev/null; then
    python3 -m venv "$1/uv"
    "$1/uv/bin/pip" install --quiet uv
    PATH="$PATH:$1/uv/bin"
    export PATH
fi
