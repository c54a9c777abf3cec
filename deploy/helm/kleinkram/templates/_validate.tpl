{{/* Rules that concern several values; values.schema.json has those of one. */}}
{{- define "kleinkram.validate" -}}
{{- $store := .Values.store -}}
{{- $backup := .Values.backup -}}
{{- $isRouted := or .Values.ingress.enabled .Values.httpRoute.enabled -}}
{{- if eq .Values.image.tag "latest" -}}
{{- fail "image.tag is latest, which changes without an upgrade: name a version, or set image.digest." -}}
{{- end -}}
{{- range $name, $_ := .Values.environment -}}
{{- if hasPrefix "KLEINKRAM_" (upper $name) -}}
{{- fail (printf "environment.%s is a setting of Kleinkram: move it to settings." $name) -}}
{{- end -}}
{{- end -}}
{{- if contains "password=" (print .Values.database.url .Values.database.migration.url) -}}
{{- fail "database.url and database.migration.url must not contain a password: use passwordSecret." -}}
{{- end -}}
{{- if eq (include "kleinkram.role" .Values.database.url) (include "kleinkram.role" .Values.database.migration.url) -}}
{{- fail "database.url and database.migration.url name the same role: the role that serves must not own the schema (docs/running.md)." -}}
{{- end -}}
{{- if and $store.accessKey $store.accessKeySecret -}}
{{- fail "store.accessKey and store.accessKeySecret are both set: set one of them." -}}
{{- end -}}
{{- if not (or $store.accessKey $store.accessKeySecret) -}}
{{- fail "The store needs an access key: set store.accessKey or store.accessKeySecret." -}}
{{- end -}}
{{- if and $store.publicUrl $store.service -}}
{{- fail "store.service publishes the bucket at publicUrl: remove store.publicUrl, or store.service if the store has an address of its own." -}}
{{- end -}}
{{- if and $store.service (not $isRouted) -}}
{{- fail "store.service publishes the bucket through ingress or httpRoute: enable one of them, or set store.publicUrl to an address of the store that clients reach." -}}
{{- end -}}
{{- $storeHost := (urlParse (include "kleinkram.storePublicUrl" .)).hostname -}}
{{- if or (hasSuffix ".svc" $storeHost) (hasSuffix ".svc.cluster.local" $storeHost) (and (not (contains "." $storeHost)) (ne $storeHost "localhost")) -}}
{{- fail (printf "Clients outside the cluster cannot reach the store at %s: set store.publicUrl, or store.service to publish the bucket at publicUrl." $storeHost) -}}
{{- end -}}
{{- if and $store.service .Values.ingress.enabled -}}
{{- if $store.service.namespace -}}
{{- fail "An Ingress cannot route to another namespace: use httpRoute with a ReferenceGrant, or a Service of type ExternalName in this namespace." -}}
{{- end -}}
{{- end -}}
{{- if and .Values.httpRoute.enabled (not .Values.httpRoute.parentRefs) -}}
{{- fail "httpRoute.parentRefs is empty: name the Gateway, as in [{name: public, namespace: gateways}]." -}}
{{- end -}}
{{- if $backup.enabled -}}
{{- if not $backup.location -}}
{{- fail "backup.location is empty: set it to s3://bucket/folder, or to /backups with backup.persistentVolumeClaim." -}}
{{- end -}}
{{- if and (hasPrefix "s3://" $backup.location) (not $backup.s3) -}}
{{- fail "backup.location is in S3: set backup.s3 (url, accessKeySecret, secretKeySecret)." -}}
{{- end -}}
{{- if and (hasPrefix "/" $backup.location) (not $backup.persistentVolumeClaim) -}}
{{- fail "backup.location is a folder: set backup.persistentVolumeClaim, which is mounted at /backups." -}}
{{- end -}}
{{- if and $backup.encrypt (not $backup.passphraseSecret) -}}
{{- fail "backup.encrypt needs backup.passphraseSecret." -}}
{{- end -}}
{{- end -}}
{{- $runner := .Values.runner.kubernetes -}}
{{- if $runner.enabled -}}
{{- if or (not $runner.namespace) (eq $runner.namespace .Release.Namespace) -}}
{{- fail "runner.kubernetes.namespace names a namespace for runs alone, which exists: who creates Jobs in a namespace can read its Secrets." -}}
{{- end -}}
{{- if not $runner.image.repository -}}
{{- fail "runner.kubernetes.image.repository is empty: name the image that you built by deploy/images/build runner." -}}
{{- end -}}
{{- if eq $runner.image.tag "latest" -}}
{{- fail "runner.kubernetes.image.tag is latest, which changes without an upgrade: name a version, or set a digest." -}}
{{- end -}}
{{- if not $runner.tokenSecret -}}
{{- fail "runner.kubernetes.tokenSecret is not set: create a token by `klein token create NAME --kind runner`, and a Secret with it." -}}
{{- end -}}
{{- end -}}
{{- end -}}
