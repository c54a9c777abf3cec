{{- define "kleinkram.name" -}}
{{- .Values.nameOverride | default .Chart.Name | trunc 63 | trimSuffix "-" -}}
{{- end -}}

{{/* Names of objects append up to 15 characters. */}}
{{- define "kleinkram.fullname" -}}
{{- $name := include "kleinkram.name" . -}}
{{- $default := contains $name .Release.Name | ternary .Release.Name (printf "%s-%s" .Release.Name $name) -}}
{{- .Values.fullnameOverride | default $default | trunc 40 | trimSuffix "-" -}}
{{- end -}}

{{/* Labels that select the pods of a component. */}}
{{- define "kleinkram.selector" -}}
app.kubernetes.io/name: {{ include "kleinkram.name" .root }}
app.kubernetes.io/instance: {{ .root.Release.Name }}
{{- with .component }}
app.kubernetes.io/component: {{ . }}
{{- end }}
{{- end -}}

{{- define "kleinkram.labels" -}}
{{ include "kleinkram.selector" . }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
helm.sh/chart: {{ printf "%s-%s" .root.Chart.Name .root.Chart.Version | replace "+" "_" }}
{{- end -}}

{{- define "kleinkram.image" -}}
{{- with .Values.image -}}
{{- if .digest -}}
{{ .repository }}@{{ .digest }}
{{- else -}}
{{ .repository }}:{{ .tag | default $.Chart.AppVersion }}
{{- end -}}
{{- end -}}
{{- end -}}

{{- define "kleinkram.serviceAccountName" -}}
{{- .Values.serviceAccount.name | default (.Values.serviceAccount.create | ternary (include "kleinkram.fullname" .) "default") -}}
{{- end -}}

{{/* The account of the hooks: those of the release do not exist yet when the first migration runs. */}}
{{- define "kleinkram.hookServiceAccountName" -}}
{{- if .Values.serviceAccount.create -}}
{{ include "kleinkram.fullname" . }}-migrate
{{- else -}}
{{ include "kleinkram.serviceAccountName" . }}
{{- end -}}
{{- end -}}

{{/* Clients reach the store at the address of the API if a Service of it is given. */}}
{{- define "kleinkram.storePublicUrl" -}}
{{- if .Values.store.publicUrl -}}
{{ .Values.store.publicUrl }}
{{- else if .Values.store.service -}}
{{ .Values.publicUrl }}
{{- else -}}
{{ .Values.store.url }}
{{- end -}}
{{- end -}}

{{- define "kleinkram.host" -}}
{{- (urlParse .Values.publicUrl).hostname -}}
{{- end -}}

{{/* The user in a database URL, which may name several hosts. */}}
{{- define "kleinkram.role" -}}
{{- . | trimPrefix "postgresql://" | splitList "@" | first -}}
{{- end -}}
