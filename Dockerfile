# The service and its models: no trainer, no torch, no compiler. Runs as nobody in particular on a read-only root.
#   docker build -t cazsl . && docker run --rm --read-only -p 8000:8000 cazsl

FROM python:3.11-slim AS build
WORKDIR /src
RUN python -m venv /opt/cazsl
# Dependencies first: this layer changes only with pyproject.toml.
COPY pyproject.toml ./
RUN python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['dependencies'], sep='\n')" > dependencies.txt \
 && /opt/cazsl/bin/pip install --no-cache-dir -r dependencies.txt
COPY README.md LICENSE ./
COPY service service
RUN /opt/cazsl/bin/pip install --no-cache-dir --no-deps . \
 && rm /opt/cazsl/bin/cazsl-train \
 && /opt/cazsl/bin/pip uninstall --yes pip setuptools

FROM python:3.11-slim
LABEL org.opencontainers.image.title="cazsl" \
      org.opencontainers.image.description="Predicts where a pushed object ends up, and how sure that is" \
      org.opencontainers.image.licenses="Apache-2.0"
COPY --from=build /opt/cazsl /opt/cazsl
COPY models /srv/models
ENV PATH=/opt/cazsl/bin:$PATH \
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
  CMD ["python", "-c", "import os, urllib.request as u; u.urlopen('http://127.0.0.1:' + os.environ['CAZSL_PORT'] + '/readyz', timeout=2)"]
ENTRYPOINT ["cazsl"]
CMD ["serve"]
