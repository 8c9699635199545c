# The library with its simulated environments, on the CPU: docs/how-to/run-in-docker.md.
FROM python:3.13-slim

WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY shape_obs shape_obs
COPY envs envs
ARG EXTRAS=sim
RUN pip install --no-cache-dir ".[${EXTRAS}]"

RUN useradd --create-home shape && mkdir /data && chown shape /data
USER shape
WORKDIR /data

# Compile the numeric functions now; otherwise each container compiles them again.
ENV NUMBA_CACHE_DIR=/tmp/shape_obs_cache
RUN shape-obs demo --renderer rays --out /tmp/demo && rm -r /tmp/demo && chmod -R a+rwX "$NUMBA_CACHE_DIR"

ENTRYPOINT ["shape-obs"]
CMD ["demo", "--renderer", "rays", "--out", "/data/demo"]
