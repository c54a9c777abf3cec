#!/bin/sh
# Create roles and database, when the PostgreSQL image starts for the first time.
set -eu
psql --set ON_ERROR_STOP=1 --username postgres --dbname postgres <<'SQL'
\set migrate `cat /run/secrets/migration-database-password`
\set serve `cat /run/secrets/database-password`
CREATE ROLE kleinkram_migrate LOGIN PASSWORD :'migrate';
CREATE ROLE kleinkram_serve LOGIN PASSWORD :'serve';
CREATE DATABASE kleinkram OWNER kleinkram_migrate TEMPLATE template0 ENCODING 'UTF8';
SQL
