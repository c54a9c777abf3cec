{{/* The secrets of a container as files, a YAML list. `.with`: "migration", "backup" or both. */}}
{{- define "kleinkram.secrets" -}}
{{- $database := .root.Values.database -}}
{{- $store := .root.Values.store -}}
{{- $backup := .root.Values.backup -}}
{{- $backupS3 := $backup.s3 | default dict -}}
{{- $secrets := list
  (dict "variable" "KLEINKRAM_DATABASE_PASSWORD_FILE" "file" "database-password" "secret" $database.passwordSecret)
  (dict "variable" "PGSSLROOTCERT" "file" "database-ca.pem" "secret" $database.caSecret)
  (dict "variable" "KLEINKRAM_S3_ACCESS_KEY_FILE" "file" "s3-access-key" "secret" $store.accessKeySecret)
  (dict "variable" "KLEINKRAM_S3_SECRET_KEY_FILE" "file" "s3-secret-key" "secret" $store.secretKeySecret)
  (dict "variable" "KLEINKRAM_S3_CA_FILE" "file" "s3-ca.pem" "secret" $store.caSecret)
  (dict "variable" "KLEINKRAM_OIDC_PROVIDERS_FILE" "file" "oidc-providers.json" "secret" .root.Values.oidcProvidersSecret)
  (dict "variable" "KLEINKRAM_PACKAGE_INDEX_FILE" "file" "package-index" "secret" .root.Values.packageIndexSecret)
  (dict "variable" "KLEINKRAM_SMTP_PASSWORD_FILE" "file" "smtp-password" "secret" .root.Values.smtpPasswordSecret)
-}}
{{- if has "migration" .with -}}
{{- $secrets = append $secrets
  (dict "variable" "KLEINKRAM_MIGRATION_DATABASE_PASSWORD_FILE" "file" "migration-database-password" "secret" $database.migration.passwordSecret)
-}}
{{- end -}}
{{- if has "backup" .with -}}
{{- $secrets = concat $secrets (list
  (dict "variable" "KLEINKRAM_BACKUP_PASSPHRASE_FILE" "file" "backup-passphrase" "secret" $backup.passphraseSecret)
  (dict "variable" "KLEINKRAM_BACKUP_S3_ACCESS_KEY_FILE" "file" "backup-s3-access-key" "secret" $backupS3.accessKeySecret)
  (dict "variable" "KLEINKRAM_BACKUP_S3_SECRET_KEY_FILE" "file" "backup-s3-secret-key" "secret" $backupS3.secretKeySecret)
  (dict "variable" "KLEINKRAM_BACKUP_S3_CA_FILE" "file" "backup-s3-ca.pem" "secret" $backupS3.caSecret)
) -}}
{{- end -}}
{{- $used := list -}}
{{- range $secrets -}}
{{- if .secret -}}
{{- $used = append $used . -}}
{{- end -}}
{{- end -}}
{{- toYaml $used -}}
{{- end -}}

{{- define "kleinkram.environment" -}}
{{- $values := .root.Values -}}
{{- $variables := dict
  "HOME" "/tmp"
  "TMPDIR" "/tmp"
  "PYTHONDONTWRITEBYTECODE" "1"
  "PYTHONFAULTHANDLER" "1"
  "KLEINKRAM_PUBLIC_URL" $values.publicUrl
  "KLEINKRAM_DATABASE_URL" $values.database.url
  "KLEINKRAM_SERVING_ROLE" (include "kleinkram.role" $values.database.url)
  "KLEINKRAM_S3_INTERNAL_URL" $values.store.url
  "KLEINKRAM_S3_PUBLIC_URL" (include "kleinkram.storePublicUrl" .root)
  "KLEINKRAM_S3_BUCKET" $values.store.bucket
  "KLEINKRAM_S3_REGION" $values.store.region
  "KLEINKRAM_S3_CORS" $values.store.corsRules
  "KLEINKRAM_METRICS_ADDRESS" $values.listenAddress
  "KLEINKRAM_METRICS_PORT" "9100"
-}}
{{- with $values.store.accessKey -}}
{{- $_ := set $variables "KLEINKRAM_S3_ACCESS_KEY" . -}}
{{- end -}}
{{- with $values.trustedProxies -}}
{{- $_ := set $variables "KLEINKRAM_TRUSTED_PROXIES" (join "," .) -}}
{{- end -}}
{{- if $values.database.caSecret -}}
{{- $_ := set $variables "PGSSLMODE" "verify-full" -}}
{{- end -}}
{{- if has "migration" .with -}}
{{- $_ := set $variables "KLEINKRAM_MIGRATION_DATABASE_URL" $values.database.migration.url -}}
{{- end -}}
{{- if has "backup" .with -}}
{{- with $values.backup.s3 -}}
{{- $_ := set $variables "KLEINKRAM_BACKUP_S3_URL" .url -}}
{{- $_ := set $variables "KLEINKRAM_BACKUP_S3_REGION" (.region | default "us-east-1") -}}
{{- end -}}
{{- end -}}
{{- range include "kleinkram.secrets" . | fromYamlArray -}}
{{- $_ := set $variables .variable (printf "/run/secrets/kleinkram/%s" .file) -}}
{{- end -}}
{{- range $name, $value := merge (dict) $values.settings $values.environment $variables }}
- name: {{ $name }}
  value: {{ kindIs "string" $value | ternary $value (toJson $value) | quote }}
{{- end -}}
{{- end -}}

{{/* What all containers have in common. `.name`, `.command`, `.resources`, `.with`. */}}
{{- define "kleinkram.container" -}}
name: {{ .name }}
image: {{ include "kleinkram.image" .root | quote }}
imagePullPolicy: {{ .root.Values.image.pullPolicy }}
command: {{ toJson .command }}
env:
  {{- include "kleinkram.environment" . | nindent 2 }}
resources:
  {{- toYaml .resources | nindent 2 }}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities:
    drop: [ALL]
volumeMounts:
  - name: tmp
    mountPath: /tmp
  - name: secrets
    mountPath: /run/secrets/kleinkram
    readOnly: true
{{- end -}}

{{/* What all pods have in common. `.settings`: the component's values; `.serviceAccountName`, `.with`, `.temporaryVolume`. */}}
{{- define "kleinkram.pod" -}}
serviceAccountName: {{ .serviceAccountName | default (include "kleinkram.serviceAccountName" .root) }}
automountServiceAccountToken: false
# Variables that describe Services could set a setting by accident.
enableServiceLinks: false
{{- with .root.Values.imagePullSecrets }}
imagePullSecrets:
  {{- toYaml . | nindent 2 }}
{{- end }}
securityContext:
  {{- toYaml .root.Values.podSecurityContext | nindent 2 }}
{{- with .settings.nodeSelector }}
nodeSelector:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .settings.tolerations }}
tolerations:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .settings.priorityClassName }}
priorityClassName: {{ . }}
{{- end }}
volumes:
  - name: tmp
    {{- include "kleinkram.temporaryVolume" .temporaryVolume | nindent 4 }}
  - name: secrets
    projected:
      defaultMode: 288  # 0440
      sources:
        {{- range include "kleinkram.secrets" . | fromYamlArray }}
        - secret:
            name: {{ .secret.name }}
            items: [{key: {{ .secret.key | quote }}, path: {{ .file }}}]
        {{- end }}
{{- end -}}

{{/* A volume of its own has a size that programs see; an emptyDir shows the free space of the node. */}}
{{- define "kleinkram.temporaryVolume" -}}
{{- if eq .type "emptyDir" -}}
emptyDir:
  sizeLimit: {{ .size }}
{{- else -}}
ephemeral:
  volumeClaimTemplate:
    spec:
      accessModes: [ReadWriteOnce]
      {{- with .storageClassName }}
      storageClassName: {{ . }}
      {{- end }}
      resources:
        requests:
          storage: {{ .size }}
{{- end -}}
{{- end -}}

{{/* Spread the pods of one version over zones and nodes, if possible. */}}
{{- define "kleinkram.spread" -}}
affinity:
  {{- if .settings.affinity }}
  {{- toYaml .settings.affinity | nindent 2 }}
  {{- else }}
  podAntiAffinity:
    preferredDuringSchedulingIgnoredDuringExecution:
      - weight: 100
        podAffinityTerm:
          topologyKey: kubernetes.io/hostname
          labelSelector:
            matchLabels:
              {{- include "kleinkram.selector" . | nindent 14 }}
  {{- end }}
topologySpreadConstraints:
  {{- if .settings.topologySpreadConstraints }}
  {{- toYaml .settings.topologySpreadConstraints | nindent 2 }}
  {{- else }}
  - maxSkew: 1
    topologyKey: topology.kubernetes.io/zone
    whenUnsatisfiable: ScheduleAnyway
    matchLabelKeys: [pod-template-hash]
    labelSelector:
      matchLabels:
        {{- include "kleinkram.selector" . | nindent 8 }}
  {{- end }}
{{- end -}}
