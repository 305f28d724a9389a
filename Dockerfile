# The service and its models, without trainer, torch and compiler. Runs as an unprivileged user on a read-only root.
#   make image && docker run --rm --read-only -p 8000:8000 cazsl
#   docker build --build-arg LOCK=s3 -t cazsl:s3 .    with registries in buckets; LOCK=all: signed models and traces too
# The same tree gives the same layers: versions are locked, and no file holds the time of the build.

# A release names the base by its digest: --build-arg PYTHON=python:3.11-slim@sha256:...
ARG PYTHON=python:3.11-slim

# The wheel. Its backend is locked as well, since pip would fetch the newest one at each build. Code that runs here, of
# the backend and of this project, has no rights.
FROM ${PYTHON} AS wheel
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /src
RUN python -m venv --without-pip /opt/backend && mkdir /wheel && chown 10001:10001 /wheel
COPY deploy/locks/build.txt backend.txt
RUN pip --python /opt/backend/bin/python install --no-deps --only-binary :all: --require-hashes --requirement backend.txt
COPY pyproject.toml README.md LICENSE ./
COPY service service
USER 10001:10001
RUN /opt/backend/bin/python -m hatchling build --target wheel --directory /wheel

# The packages. Only wheels are installed, so none of their code runs.
FROM ${PYTHON} AS build
ARG LOCK=serving
ENV PIP_NO_CACHE_DIR=1 PIP_NO_COMPILE=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /src
RUN python -m venv --without-pip /opt/cazsl
# Dependencies come first, so this layer changes only with them. A lock has the digest of every file to install.
# With --no-deps pip installs the lock only. (Without it, pip would search for pydantic[email] and refuse the lock.)
COPY deploy/locks/${LOCK}.txt requirements.txt
RUN pip --python /opt/cazsl/bin/python install --no-deps --only-binary :all: --require-hashes --requirement requirements.txt
COPY --from=wheel /wheel /src/wheel
# Deleted: the runtime's library for programs in C (35 MB; Python's module contains the runtime), tests and tools of
# packages, C++ sources, and AVIF (pictures are PNG, JPEG or WebP). A missing path ends the build.
# Bytecode is a tenth of the rest and makes the start a third faster. It has no timestamps, so layers stay the same.
RUN pip --python /opt/cazsl/bin/python install --no-deps --no-index /src/wheel/*.whl \
 && rm /opt/cazsl/bin/cazsl-train \
 && packages=$(echo /opt/cazsl/lib/python3.*/site-packages) \
 && find "$packages" -depth '(' -type d -name tests -o -name '*.cc' -o -name '*.h' ')' -exec rm -r '{}' + \
 && rm -r "$packages"/onnxruntime/capi/libonnxruntime.so.* \
          "$packages"/onnxruntime/transformers "$packages"/onnxruntime/tools "$packages"/onnxruntime/quantization \
          "$packages"/onnx/backend/test "$packages"/onnx/reference "$packages"/numpy/f2py \
          "$packages"/pillow.libs/libavif-* "$packages"/PIL/_avif.*.so \
          "$packages"/fastapi_offline/static/redoc.standalone.js \
 && PYTHONHASHSEED=0 python -m compileall -q -f --invalidation-mode unchecked-hash /opt/cazsl/lib
COPY models /image/srv/models
RUN mkdir -p /image/opt && mv /opt/cazsl /image/opt/cazsl \
 && find /image -exec touch --no-dereference --date=@0 '{}' +

FROM ${PYTHON}
ARG VERSION=""
ARG REVISION=""
LABEL org.opencontainers.image.title="cazsl" \
      org.opencontainers.image.description="Predicts where a pushed object ends up, and how sure that is" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}" \
      org.opencontainers.image.base.name="docker.io/library/python:3.11-slim"
COPY --from=build /image /
# MALLOC_MMAP_THRESHOLD_ fixes glibc's limit for large blocks. By default glibc raises it when a model is released, and
# then keeps freed memory. Up to 4 MiB of small blocks stay for the next requests. Pillow keeps two blocks of up to 16
# MiB for the next picture. Returned to the system, each block costs a page fault per 4 KiB.
ENV MALLOC_MMAP_THRESHOLD_=131072 \
    MALLOC_TRIM_THRESHOLD_=4194304 \
    PILLOW_BLOCKS_MAX=2 \
    PATH=/opt/cazsl/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    CAZSL_HOST=0.0.0.0 \
    CAZSL_PORT=8000 \
    CAZSL_REGISTRY=/srv/models
USER 10001:10001
WORKDIR /srv
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=3s --start-period=10s --retries=3 \
  CMD ["python", "-c", "import os, urllib.request as u; u.build_opener(u.ProxyHandler({})).open('http://127.0.0.1:' + (os.environ.get('CAZSL_PORT', '').strip() or '8000') + '/readyz', timeout=2)"]
ENTRYPOINT ["cazsl"]
CMD ["serve"]
