// Written by `npm run generate` from docs/openapi.json. Do not edit.

export interface paths {
    readonly "/api/v1/audit": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Audit Events
         * @description List what happened, latest first.
         */
        readonly get: operations["list_audit_events"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/audit/export": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Export Audit Events
         * @description Give all events that match, oldest first, one JSON object a line.
         */
        readonly get: operations["export_audit_events"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/claim": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Claim Server
         * @description Become the first admin of a fresh server, by the code from its log.
         */
        readonly post: operations["claim_server"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/cli/approve": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Approve Cli Login
         * @description Agree that a program on the browser's machine gets a token.
         */
        readonly post: operations["approve_cli_login"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/cli/token": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Exchange Cli Code
         * @description Exchange what the browser brought to the loopback for a token.
         */
        readonly post: operations["exchange_cli_code"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/codes": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Look At Code
         * @description Say for whom a link is; it stays good.
         */
        readonly post: operations["look_at_code"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/device": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Begin Device Login
         * @description Begin a login by a code that is typed on another machine.
         */
        readonly post: operations["begin_device_login"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/device/approve": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Approve Device Login
         * @description Agree that the program that shows a code gets a token.
         */
        readonly post: operations["approve_device_login"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/device/deny": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Deny Device Login
         * @description Disagree.
         */
        readonly post: operations["deny_device_login"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/device/look": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Look At Device Login
         * @description Say who shows a code.
         */
        readonly post: operations["look_at_device_login"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/device/token": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Exchange Device Code
         * @description Exchange a device's secret for a token, once its code was typed.
         */
        readonly post: operations["exchange_device_code"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/invitation": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Accept Invitation
         * @description Get the account that one is invited to, and sign in.
         */
        readonly post: operations["accept_invitation"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/link": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Sign In By Link
         * @description Sign a browser in by a link that is good once.
         */
        readonly post: operations["sign_in_by_link"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/owner-link": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Create Owner Link
         * @description Make a link by which the owner of `klein up` signs a browser in.
         */
        readonly post: operations["create_owner_link"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/password": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Sign In By Password
         * @description Sign a browser in with a local account.
         */
        readonly post: operations["sign_in_by_password"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/password/change": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Change Password
         * @description Choose a new password; one's other browsers are signed out.
         */
        readonly post: operations["change_password"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/providers/{name}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Begin Provider Sign In
         * @description Begin to sign in by a provider: the browser goes where this says.
         */
        readonly post: operations["begin_provider_sign_in"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/providers/{name}/link": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Link Provider
         * @description Begin to add a provider to one's account, as another way to sign in.
         */
        readonly post: operations["link_provider"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/reset": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Reset Password
         * @description Choose a new password by an admin's link; all other browsers are signed out.
         */
        readonly post: operations["reset_password"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/sign-out": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Sign Out
         * @description Sign this browser out.
         */
        readonly post: operations["sign_out"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/auth/ways": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Sign In Ways
         * @description Say how one may sign in here.
         */
        readonly get: operations["list_sign_in_ways"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/files": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Files
         * @description List the files that match.
         */
        readonly get: operations["list_files"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/files/{file_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get File
         * @description Return one file.
         */
        readonly get: operations["get_file"];
        readonly put?: never;
        readonly post?: never;
        /**
         * Delete File
         * @description Move a file to the trash.
         */
        readonly delete: operations["delete_file"];
        readonly options?: never;
        readonly head?: never;
        /**
         * Update File
         * @description Rename, move or label a file; what is left out stays.
         */
        readonly patch: operations["update_file"];
        readonly trace?: never;
    };
    readonly "/api/v1/files/{file_id}/prove": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Prove File
         * @description Have a file's bytes read again; its state and time of proof tell when that is done.
         */
        readonly post: operations["prove_file"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/files/{file_id}/topics": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List File Topics
         * @description List the topics of one file, by name.
         */
        readonly get: operations["list_file_topics"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/files/download": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Download Files
         * @description Return where to read the bytes of files; who asked is noted.
         */
        readonly post: operations["download_files"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/groups": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Groups
         * @description List the groups one is in, by name; admins see all.
         */
        readonly get: operations["list_groups"];
        readonly put?: never;
        /**
         * Create Group
         * @description Make a group; its maker is its first member and editor.
         */
        readonly post: operations["create_group"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/groups/{group_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Group
         * @description Return one group.
         */
        readonly get: operations["get_group"];
        readonly put?: never;
        readonly post?: never;
        /**
         * Delete Group
         * @description Delete a group, and with it what was granted to it.
         */
        readonly delete: operations["delete_group"];
        readonly options?: never;
        readonly head?: never;
        /**
         * Update Group
         * @description Rename a group.
         */
        readonly patch: operations["update_group"];
        readonly trace?: never;
    };
    readonly "/api/v1/groups/{group_id}/members": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Group Members
         * @description List the people in a group, by name; addresses and those whose time is over are for its editors.
         */
        readonly get: operations["list_group_members"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/groups/{group_id}/members/{person_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        /**
         * Set Group Member
         * @description Put somebody into a group, or change how and until when they are in it.
         */
        readonly put: operations["set_group_member"];
        readonly post?: never;
        /**
         * Remove Group Member
         * @description Take somebody out of a group, or leave it.
         */
        readonly delete: operations["remove_group_member"];
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/me": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Me
         * @description Say who asks, and what their credential is good for.
         */
        readonly get: operations["get_me"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/me/identities": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Identities
         * @description List under whose word one signs in.
         */
        readonly get: operations["list_identities"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/me/sessions": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Sessions
         * @description List the browsers that one is signed in with, latest first.
         */
        readonly get: operations["list_sessions"];
        readonly put?: never;
        readonly post?: never;
        /**
         * End All Sessions
         * @description Sign all of one's browsers out, this one too. Tokens stay as they are.
         */
        readonly delete: operations["end_all_sessions"];
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/me/sessions/{session_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        readonly post?: never;
        /**
         * End Session
         * @description Sign one of one's browsers out.
         */
        readonly delete: operations["end_session"];
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/missions": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Missions
         * @description List the missions that match.
         */
        readonly get: operations["list_missions"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/missions/{mission_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Mission
         * @description Return one mission.
         */
        readonly get: operations["get_mission"];
        readonly put?: never;
        readonly post?: never;
        /**
         * Delete Mission
         * @description Move a mission and its files to the trash.
         */
        readonly delete: operations["delete_mission"];
        readonly options?: never;
        readonly head?: never;
        /**
         * Update Mission
         * @description Rename, move, complete or describe a mission; what is left out stays.
         */
        readonly patch: operations["update_mission"];
        readonly trace?: never;
    };
    readonly "/api/v1/missions/{mission_id}/access": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Mission Access
         * @description List who has a right on a mission now, by grants on it or on its project; without WRITE, only the asker's own.
         */
        readonly get: operations["get_mission_access"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/missions/{mission_id}/grants": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Mission Grants
         * @description List the grants on a mission by itself.
         */
        readonly get: operations["list_mission_grants"];
        readonly put?: never;
        /**
         * Create Mission Grant
         * @description Give a right on one mission; it shows the project's name, and nothing else of it.
         */
        readonly post: operations["create_mission_grant"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/missions/{mission_id}/grants/{grant_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        readonly post?: never;
        /**
         * Delete Mission Grant
         * @description Take a right on a mission away.
         */
        readonly delete: operations["delete_mission_grant"];
        readonly options?: never;
        readonly head?: never;
        /**
         * Update Mission Grant
         * @description Change what right a grant on a mission gives, or until when; what is left out stays.
         */
        readonly patch: operations["update_mission_grant"];
        readonly trace?: never;
    };
    readonly "/api/v1/missions/{mission_id}/recordings": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Recordings
         * @description List the recordings of a mission, by name.
         */
        readonly get: operations["list_recordings"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/missions/{mission_id}/shares": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Create Share
         * @description Make a link to a mission or to some of its files; its secret is shown here and never again.
         */
        readonly post: operations["create_share"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/missions/{mission_id}/uploads": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Open
         * @description List your uploads under way into a mission.
         */
        readonly get: operations["list_uploads"];
        readonly put?: never;
        /**
         * Begin
         * @description Say what you want to upload, and hear what to send.
         */
        readonly post: operations["begin_uploads"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/people": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List People
         * @description List the people one may know of: who shares a group or a project; admins see all.
         */
        readonly get: operations["list_people"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/people/{person_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Person
         * @description Return one person.
         */
        readonly get: operations["get_person"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/people/{person_id}/admin": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Make Admin
         * @description Make somebody an admin, without an end.
         */
        readonly post: operations["make_admin"];
        /**
         * Unmake Admin
         * @description Take the power of an admin from somebody; the last lasting one keeps it.
         */
        readonly delete: operations["unmake_admin"];
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/people/{person_id}/deactivate": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Deactivate Person
         * @description End somebody's sessions, tokens and links at once; what only they owned goes to the admins.
         */
        readonly post: operations["deactivate_person"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/people/{person_id}/reactivate": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Reactivate Person
         * @description Let somebody who left sign in again; their tokens stay revoked.
         */
        readonly post: operations["reactivate_person"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/people/{person_id}/reset": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Create Reset Link
         * @description Make a link by which somebody chooses a new password; whoever asks gives it to them.
         */
        readonly post: operations["create_reset_link"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/people/invitations": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Invite Person
         * @description Make a link by which somebody gets an account; whoever asks gives it to them.
         */
        readonly post: operations["invite_person"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/projects": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Projects
         * @description List the projects that match.
         */
        readonly get: operations["list_projects"];
        readonly put?: never;
        /**
         * Create Project
         * @description Make a project.
         */
        readonly post: operations["create_project"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/projects/{project_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Project
         * @description Return one project.
         */
        readonly get: operations["get_project"];
        readonly put?: never;
        readonly post?: never;
        /**
         * Delete Project
         * @description Move a project and all in it to the trash.
         */
        readonly delete: operations["delete_project"];
        readonly options?: never;
        readonly head?: never;
        /**
         * Update Project
         * @description Rename or describe a project, or change its metadata fields; what is left out stays.
         */
        readonly patch: operations["update_project"];
        readonly trace?: never;
    };
    readonly "/api/v1/projects/{project_id}/access": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Project Access
         * @description List who has a right on a project now, and by what; without WRITE there, only the asker's own ways.
         */
        readonly get: operations["get_project_access"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/projects/{project_id}/grants": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Project Grants
         * @description List the grants on a project, by the name of whom they are to; those that have expired too.
         */
        readonly get: operations["list_project_grants"];
        readonly put?: never;
        /**
         * Create Project Grant
         * @description Give a right on a project and all its missions; it takes the place of the one given there before.
         */
        readonly post: operations["create_project_grant"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/projects/{project_id}/grants/{grant_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        readonly post?: never;
        /**
         * Delete Project Grant
         * @description Take a right on a project away.
         */
        readonly delete: operations["delete_project_grant"];
        readonly options?: never;
        readonly head?: never;
        /**
         * Update Project Grant
         * @description Change what right a grant on a project gives, or until when; what is left out stays.
         */
        readonly patch: operations["update_project_grant"];
        readonly trace?: never;
    };
    readonly "/api/v1/projects/{project_id}/missions": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Create Mission
         * @description Make a mission; its metadata must satisfy the project's fields.
         */
        readonly post: operations["create_mission"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/projects/{project_id}/template": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Mission Template
         * @description Return the metadata YAML to fill in for the project's next mission.
         */
        readonly get: operations["get_mission_template"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/recordings/{recording_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Recording
         * @description Return one recording.
         */
        readonly get: operations["get_recording"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/service": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Service
         * @description Say what this server is, and who you are to it.
         */
        readonly get: operations["get_service"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/share": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Shared
         * @description Say what the link shows that the request came with.
         */
        readonly get: operations["get_share"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/shares": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Shares
         * @description List the links that you may revoke, latest first; with `ended` also those that are over.
         */
        readonly get: operations["list_shares"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/shares/{share_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        readonly post?: never;
        /**
         * Revoke Share
         * @description End a link, from the next request on.
         */
        readonly delete: operations["revoke_share"];
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/stats": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get Stats
         * @description Return hours, bytes, files and messages of the files that match.
         */
        readonly get: operations["get_stats"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/tokens": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Tokens
         * @description List tokens, latest first; with `ended` also those that were revoked or have expired.
         */
        readonly get: operations["list_tokens"];
        readonly put?: never;
        /**
         * Create Token
         * @description Make a token; its secret is shown here and never again.
         */
        readonly post: operations["create_token"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/tokens/{token_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        readonly post?: never;
        /**
         * Revoke Token
         * @description End a token and all that were made with it, from the next request on; with `made=kept` only itself.
         */
        readonly delete: operations["revoke_token"];
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/topics": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Topics
         * @description List the topics of the files that match, by name.
         */
        readonly get: operations["list_topics"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/trash": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * List Trash
         * @description List what was deleted and can still be had back, latest first.
         */
        readonly get: operations["list_trash"];
        readonly put?: never;
        readonly post?: never;
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/trash/{noun}/{noun_id}/restore": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Restore From Trash
         * @description Put a deleted thing back where it was.
         */
        readonly post: operations["restore_from_trash"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/uploads/{upload_id}": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        /**
         * Get
         * @description Get one of your uploads, with the parts that the store holds.
         */
        readonly get: operations["get_upload"];
        readonly put?: never;
        readonly post?: never;
        /**
         * Abort
         * @description Give up an upload.
         */
        readonly delete: operations["abort_upload"];
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/uploads/complete": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Complete
         * @description Finish uploads whose parts are all sent.
         */
        readonly post: operations["complete_uploads"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
    readonly "/api/v1/uploads/parts": {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly get?: never;
        readonly put?: never;
        /**
         * Sign
         * @description Get the addresses to send parts to; this also renews the leases of their uploads.
         */
        readonly post: operations["sign_parts"];
        readonly delete?: never;
        readonly options?: never;
        readonly head?: never;
        readonly patch?: never;
        readonly trace?: never;
    };
}
export type webhooks = Record<string, never>;
export interface components {
    schemas: {
        /**
         * AccessRead
         * @description One way in which somebody has a right now; of several, the highest counts.
         *
         *     `to` is who was granted it; null: all admins, or, where the project is public, everybody. `person` is who has it by
         *     that; null where that is not known, or not for the one who asks: the members of a group, whoever has an address.
         *     `expires_at` is when the grant or the membership ends, whichever is first.
         */
        readonly AccessRead: {
            /** Expires At */
            readonly expires_at: string | null;
            /** Grant Id */
            readonly grant_id: string | null;
            readonly person: components["schemas"]["PersonRef"] | null;
            readonly right: components["schemas"]["Right"];
            readonly through: components["schemas"]["AccessThrough"];
            readonly to: components["schemas"]["Grantee"] | null;
        };
        /**
         * AccessThrough
         * @description What a right comes from: a grant on the project or the mission, the project's being public, or being an admin.
         * @enum {string}
         */
        readonly AccessThrough: "project grant" | "mission grant" | "public" | "admin";
        /**
         * AuditRead
         * @description One event: who did what to what, with what changed.
         *
         *     `address` and `session_id` of a person are theirs and the admins' to see; of a link or a stranger, the owners' too.
         *     `as_admin`: it took the power of an admin; by their own rights they would have been refused.
         */
        readonly AuditRead: {
            readonly actor: components["schemas"]["PersonRef"] | null;
            /** Address */
            readonly address: string | null;
            /** After */
            readonly after: {
                readonly [key: string]: components["schemas"]["JsonValue"];
            };
            /** As Admin */
            readonly as_admin: boolean;
            /**
             * At
             * Format: date-time
             */
            readonly at: string;
            /** Before */
            readonly before: {
                readonly [key: string]: components["schemas"]["JsonValue"];
            };
            /** Id */
            readonly id: number;
            /** Mission Id */
            readonly mission_id: string | null;
            /** Noun */
            readonly noun: string;
            /** Noun Id */
            readonly noun_id: string | null;
            /** Noun Name */
            readonly noun_name: string;
            /** Operation */
            readonly operation: string;
            /** Project Id */
            readonly project_id: string | null;
            /** Request Id */
            readonly request_id: string | null;
            /** Session Id */
            readonly session_id: string | null;
            readonly share: components["schemas"]["CredentialRef"] | null;
            readonly token: components["schemas"]["CredentialRef"] | null;
        };
        /**
         * BlobState
         * @description What is known of the bytes: the store's checksums agreed; the server read them; gone; not what they were.
         * @enum {string}
         */
        readonly BlobState: "stored" | "proven" | "lost" | "corrupt";
        /**
         * BrowserSignedIn
         * @description Who a browser is signed in as, from now on; the session itself is in a cookie that no script can read.
         */
        readonly BrowserSignedIn: {
            readonly person: components["schemas"]["PersonRef"];
        };
        /**
         * ChecksumKind
         * @description How the store proves what it received, as found by the server's probe when it started.
         *
         *     `crc64nvme`: every part by a signed CRC-64/NVME header, and the whole object by the full-object CRC-64/NVME.
         *     `sha256`: every part by a signed SHA-256 header. `md5`: every part by a signed Content-MD5, for old stores.
         * @enum {string}
         */
        readonly ChecksumKind: "crc64nvme" | "sha256" | "md5";
        /**
         * Claim
         * @description Become the first admin of a fresh server: `POST /auth/claim`. Who is signed in gives the code alone.
         */
        readonly Claim: {
            /** Code */
            readonly code: string;
            /** Email */
            readonly email?: string | null;
            /** Name */
            readonly name?: string | null;
            /** Password */
            readonly password?: string | null;
        };
        /**
         * CliExchange
         * @description Exchange what the browser brought for a token: `POST /auth/cli/token`. A code is good for once.
         */
        readonly CliExchange: {
            /** Code */
            readonly code: string;
            /** Code Verifier */
            readonly code_verifier: string;
        };
        /**
         * CodeRead
         * @description For whom a link is: `POST /auth/codes`. Asking does not use it.
         */
        readonly CodeRead: {
            /** Email */
            readonly email: string | null;
            /** Name */
            readonly name: string | null;
            /** Purpose */
            readonly purpose: string;
        };
        /**
         * CodeSignIn
         * @description Sign in by a link that is good once: `POST /auth/link`.
         */
        readonly CodeSignIn: {
            /** Code */
            readonly code: string;
        };
        /**
         * Completed
         * @description The store agreed; the file exists. It is null for who may not read, where another brought the same bytes.
         */
        readonly Completed: {
            readonly file: components["schemas"]["FileRead"] | null;
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            readonly outcome: "completed";
            /**
             * Upload Id
             * Format: uuid
             */
            readonly upload_id: string;
        };
        /**
         * ContentState
         * @description What is known of the meaning of the bytes (see the concepts page).
         * @enum {string}
         */
        readonly ContentState: "pending" | "indexed" | "recovered" | "broken" | "opaque" | "error";
        /**
         * CredentialKind
         * @description What somebody came with.
         * @enum {string}
         */
        readonly CredentialKind: "session" | "personal" | "robot" | "runner";
        /**
         * CredentialRead
         * @description The token or browser session of this very request. `is_limited`: it reaches certain projects or missions only.
         *
         *     `DELETE /tokens/{id}` ends a token, `DELETE /me/sessions/{id}` a session.
         */
        readonly CredentialRead: {
            /** Expires At */
            readonly expires_at: string | null;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Is Limited */
            readonly is_limited: boolean;
            readonly kind: components["schemas"]["CredentialKind"];
            /** Name */
            readonly name: string;
            /** Scopes */
            readonly scopes: readonly components["schemas"]["Scope"][];
        };
        /**
         * CredentialRef
         * @description A token or a link, by the name that it was given.
         */
        readonly CredentialRef: {
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Name */
            readonly name: string;
        };
        /**
         * Deleted
         * @description What a deletion moved to the trash (or, as a dry run, would move).
         */
        readonly Deleted: {
            /** Dry Run */
            readonly dry_run: boolean;
            /** Files */
            readonly files: number;
            /** Missions */
            readonly missions: number;
            /** Size Bytes */
            readonly size_bytes: number;
        };
        /**
         * Departure
         * @description What ended when somebody was deactivated, and the projects that went to the admins for want of another owner.
         */
        readonly Departure: {
            /** Links */
            readonly links: number;
            readonly person: components["schemas"]["PersonRef"];
            /** Projects */
            readonly projects: readonly string[];
            /** Sessions */
            readonly sessions: number;
            /** Tokens */
            readonly tokens: number;
        };
        /**
         * DeviceBegin
         * @description Ask for a code that can be typed on another machine: `POST /auth/device`.
         */
        readonly DeviceBegin: {
            /**
             * Client
             * @default klein
             */
            readonly client: string;
        };
        /**
         * DeviceCode
         * @description Where to type which code, and how to ask whether it was.
         */
        readonly DeviceCode: {
            /** Device Code */
            readonly device_code: string;
            /** Expires S */
            readonly expires_s: number;
            /** Interval S */
            readonly interval_s: number;
            /** User Code */
            readonly user_code: string;
            /** Verification Url */
            readonly verification_url: string;
            /** Verification Url Complete */
            readonly verification_url_complete: string;
        };
        /**
         * DeviceDecision
         * @description Agree or disagree that the program that shows this code gets a token: `POST /auth/device/approve` or `/deny`.
         */
        readonly DeviceDecision: {
            /** User Code */
            readonly user_code: string;
        };
        /**
         * DeviceExchange
         * @description Ask whether the code was typed: `POST /auth/device/token`.
         */
        readonly DeviceExchange: {
            /** Device Code */
            readonly device_code: string;
        };
        /**
         * DeviceRead
         * @description Who asks by a code: `POST /auth/device/look`.
         */
        readonly DeviceRead: {
            /** Address */
            readonly address: string | null;
            /** Client */
            readonly client: string;
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
        };
        /**
         * DownloadLink
         * @description Where to read one file's bytes: GET with or without a Range header, until `expires_at`.
         */
        readonly DownloadLink: {
            /** Crc64Nvme */
            readonly crc64nvme: string | null;
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
            /**
             * File Id
             * Format: uuid
             */
            readonly file_id: string;
            /** Path */
            readonly path: string;
            /** Sha256 */
            readonly sha256: string | null;
            /** Size Bytes */
            readonly size_bytes: number;
            readonly state: components["schemas"]["BlobState"];
            /** Url */
            readonly url: string;
        };
        /**
         * DownloadLinks
         * @description Links, one a file, in the order asked.
         */
        readonly DownloadLinks: {
            /** Items */
            readonly items: readonly components["schemas"]["DownloadLink"][];
        };
        /**
         * DownloadRequest
         * @description Files to fetch.
         */
        readonly DownloadRequest: {
            /** File Ids */
            readonly file_ids: readonly string[];
        };
        /**
         * ErrorCode
         * @description The closed set of failures.
         * @enum {string}
         */
        readonly ErrorCode: "not_authenticated" | "sign_in_pending" | "slow_down" | "sign_in_denied" | "sign_in_expired" | "sign_in_failed" | "sign_in_refused" | "code_gone" | "provider_unavailable" | "rate_limited" | "forbidden" | "scope_missing" | "token_too_wide" | "right_exceeded" | "last_owner" | "last_admin" | "group_fixed" | "not_found" | "ambiguous_name" | "name_taken" | "invalid_request" | "invalid_query" | "invalid_cursor" | "yaml_invalid" | "fields_invalid" | "metadata_invalid" | "body_too_large" | "file_exists" | "path_conflict" | "name_leased" | "upload_gone" | "upload_incomplete" | "checksum_mismatch" | "file_unavailable" | "quota_exceeded" | "method_not_allowed" | "store_unavailable" | "database_unavailable" | "internal_error";
        /**
         * FieldProblem
         * @description One thing wrong with one field of a request, a metadata document or a field definition.
         */
        readonly FieldProblem: {
            /** Column */
            readonly column?: number | null;
            /** Field */
            readonly field: string;
            /** Line */
            readonly line?: number | null;
            /** Message */
            readonly message: string;
        };
        /**
         * FieldType
         * @description What kind of value a metadata field takes.
         * @enum {string}
         */
        readonly FieldType: "string" | "number" | "boolean" | "date" | "location" | "link" | "choice";
        /**
         * FileFact
         * @description One thing more that a file says of itself, such as the number of poses of a trajectory.
         */
        readonly FileFact: {
            /** Name */
            readonly name: string;
            /** Unit */
            readonly unit: string;
            /** Value */
            readonly value: string | number;
        };
        /**
         * FileLoss
         * @description What of a damaged recording cannot be read. `messages` is null where nothing in the file tells.
         */
        readonly FileLoss: {
            /** Bytes */
            readonly bytes: number;
            /** Chunks */
            readonly chunks: number;
            /** Messages */
            readonly messages: number | null;
        };
        /**
         * FileProblem
         * @description Something odd inside a recording, in plain words.
         */
        readonly FileProblem: {
            /** Code */
            readonly code: string;
            /** Message */
            readonly message: string;
            /** Where */
            readonly where: string;
        };
        /**
         * FileRead
         * @description A file of a mission: its place, its bytes, and what they hold. Checksums are lower-case hex.
         *
         *     `sha256` is the uploader's word until `state` is `proven`; `md5` is null until then. `summarised_at` is null until
         *     the server has looked at the content, whatever came of it. `depth` says how far it read; null until then.
         */
        readonly FileRead: {
            /** Compression */
            readonly compression: readonly string[];
            readonly content: components["schemas"]["ContentState"];
            /** Content Reason */
            readonly content_reason: string | null;
            /** Crc64Nvme */
            readonly crc64nvme: string | null;
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            readonly depth: components["schemas"]["ReadDepth"] | null;
            /** End Ns */
            readonly end_ns: number | null;
            /** Facts */
            readonly facts: readonly components["schemas"]["FileFact"][];
            /** Format */
            readonly format: string | null;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Labels */
            readonly labels: readonly string[];
            readonly lost: components["schemas"]["FileLoss"] | null;
            /** Md5 */
            readonly md5: string | null;
            /** Message Count */
            readonly message_count: number | null;
            readonly mission: components["schemas"]["MissionRef"];
            /** Origin */
            readonly origin: string;
            /** Path */
            readonly path: string;
            /** Problems */
            readonly problems: readonly components["schemas"]["FileProblem"][];
            /** Proven At */
            readonly proven_at: string | null;
            /** Recording Id */
            readonly recording_id: string | null;
            /** Sha256 */
            readonly sha256: string | null;
            /** Size Bytes */
            readonly size_bytes: number;
            /** Start Ns */
            readonly start_ns: number | null;
            readonly state: components["schemas"]["BlobState"];
            /** State Reason */
            readonly state_reason: string | null;
            /** Summarised At */
            readonly summarised_at: string | null;
            readonly uploaded_by: components["schemas"]["PersonRef"];
        };
        /**
         * FileSort
         * @description Orders of a list of files. `path` orders by project, mission and path.
         * @enum {string}
         */
        readonly FileSort: "path" | "-path" | "created" | "-created" | "size" | "-size" | "start" | "-start";
        /**
         * FileUpdate
         * @description What to change of a file; what is left out stays. A path renames, a mission moves; no object is touched.
         */
        readonly FileUpdate: {
            /** Labels */
            readonly labels?: readonly string[] | null;
            /** Mission Id */
            readonly mission_id?: string | null;
            /** Path */
            readonly path?: string | null;
        };
        /**
         * GrantCreate
         * @description A right to give, to exactly one of a person, a group and an address; without `expires_at` it has no end.
         *
         *     Where they were granted a right there before, this takes its place.
         */
        readonly GrantCreate: {
            /** Email */
            readonly email?: string | null;
            /** Expires At */
            readonly expires_at?: string | null;
            /** Group Id */
            readonly group_id?: string | null;
            /** Person Id */
            readonly person_id?: string | null;
            readonly right: components["schemas"]["Right"];
        };
        /**
         * Grantee
         * @description Whom a right is given to. An address has no id, whether or not somebody has it; its name is the address.
         */
        readonly Grantee: {
            /** Id */
            readonly id: string | null;
            readonly kind: components["schemas"]["GranteeKind"];
            /** Name */
            readonly name: string;
        };
        /**
         * GranteeKind
         * @description Whom a right is given to: a person, a group, or whoever has an e-mail address.
         * @enum {string}
         */
        readonly GranteeKind: "person" | "group" | "email";
        /**
         * GrantOn
         * @description Where a grant stands. One on a project holds for all its missions.
         * @enum {string}
         */
        readonly GrantOn: "project" | "mission";
        /**
         * GrantRead
         * @description A right that was given. One that has expired has no effect any more.
         */
        readonly GrantRead: {
            /** Expires At */
            readonly expires_at: string | null;
            /**
             * Granted At
             * Format: date-time
             */
            readonly granted_at: string;
            readonly granted_by: components["schemas"]["PersonRef"] | null;
            /** Has Expired */
            readonly has_expired: boolean;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            readonly on: components["schemas"]["GrantOn"];
            readonly right: components["schemas"]["Right"];
            readonly to: components["schemas"]["Grantee"];
        };
        /**
         * GrantUpdate
         * @description What to change of a grant; what is left out stays. `expires_at` null takes its end away.
         */
        readonly GrantUpdate: {
            /** Expires At */
            readonly expires_at?: string | null;
            readonly right?: components["schemas"]["Right"] | null;
        };
        /**
         * GroupCreate
         * @description A group to make; whoever makes it is its first member and editor.
         */
        readonly GroupCreate: {
            /** Name */
            readonly name: string;
        };
        /**
         * GroupKind
         * @description How a group gets its members.
         *
         *     `person`: one person's own, always just that person. `email`: whoever proves that address. `custom`: by its editors.
         *     `affiliation`: by the domain of a verified address. `admins`: by admins.
         * @enum {string}
         */
        readonly GroupKind: "person" | "email" | "custom" | "affiliation" | "admins";
        /**
         * GroupRead
         * @description A group. Members whose time is over, or who left, do not count.
         *
         *     `is_member`, `is_editor` and `expires_at` are the asker's own membership. `domains` and `default_right` are what the
         *     settings say of an affiliation group.
         */
        readonly GroupRead: {
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            readonly created_by: components["schemas"]["PersonRef"] | null;
            readonly default_right: components["schemas"]["Right"] | null;
            /** Domains */
            readonly domains: readonly string[];
            /** Expires At */
            readonly expires_at: string | null;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Is Editor */
            readonly is_editor: boolean;
            /** Is Member */
            readonly is_member: boolean;
            readonly kind: components["schemas"]["GroupKind"];
            /** Member Count */
            readonly member_count: number;
            /** Name */
            readonly name: string;
        };
        /**
         * GroupUpdate
         * @description A group's new name.
         */
        readonly GroupUpdate: {
            /** Name */
            readonly name: string;
        };
        /**
         * HashFirst
         * @description Something of this name or size is kept already: ask again with the sha256.
         */
        readonly HashFirst: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            readonly decision: "hash_first";
            /** Path */
            readonly path: string;
        };
        /**
         * HeldPart
         * @description A part that the store already holds.
         */
        readonly HeldPart: {
            /** Etag */
            readonly etag: string;
            /** Number */
            readonly number: number;
            /** Size Bytes */
            readonly size_bytes: number;
        };
        /**
         * IdentityRead
         * @description Under whose word one signs in: `GET /me/identities`.
         */
        readonly IdentityRead: {
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            /** Email */
            readonly email: string | null;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Issuer */
            readonly issuer: string;
            /**
             * Last Used At
             * Format: date-time
             */
            readonly last_used_at: string;
        };
        /**
         * InvitationAccept
         * @description Get the account that one is invited to: `POST /auth/invitation`.
         */
        readonly InvitationAccept: {
            /** Code */
            readonly code: string;
            /** Name */
            readonly name?: string | null;
            /** Password */
            readonly password: string;
        };
        /**
         * InvitationCreate
         * @description Invite somebody to an account: `POST /people/invitations`. That the address is theirs is the word of who does.
         */
        readonly InvitationCreate: {
            /** Email */
            readonly email: string;
            /** Name */
            readonly name?: string | null;
        };
        readonly JsonValue: unknown;
        /**
         * Linked
         * @description The same bytes are kept already and you may read them: the file now exists, nothing to send.
         */
        readonly Linked: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            readonly decision: "linked";
            readonly file: components["schemas"]["FileRead"];
        };
        /**
         * Location
         * @description A place on earth. Degrees, WGS 84; altitude in metres above the ellipsoid.
         */
        readonly Location: {
            /** Altitude */
            readonly altitude?: number | null;
            /** Latitude */
            readonly latitude: number;
            /** Longitude */
            readonly longitude: number;
            /** Name */
            readonly name?: string | null;
        };
        /**
         * LoopbackApproval
         * @description Agree that a program on this machine gets a token: `POST /auth/cli/approve`. It listens on 127.0.0.1:`port`.
         */
        readonly LoopbackApproval: {
            /**
             * Client
             * @default klein
             */
            readonly client: string;
            /** Code Challenge */
            readonly code_challenge: string;
            /** Port */
            readonly port: number;
            /** State */
            readonly state: string;
        };
        /**
         * LoopbackApproved
         * @description Where the browser brings the code.
         */
        readonly LoopbackApproved: {
            /** Url */
            readonly url: string;
        };
        /**
         * Made
         * @description What becomes of the tokens that one made, when it ends.
         * @enum {string}
         */
        readonly Made: "ended" | "kept";
        /**
         * MemberRead
         * @description Somebody in a group. `emails` are for its editors and admins, as are members who are not active any more.
         *
         *     `is_active`: neither has their time ended, nor did they leave.
         */
        readonly MemberRead: {
            /**
             * Added At
             * Format: date-time
             */
            readonly added_at: string;
            readonly added_by: components["schemas"]["PersonRef"] | null;
            /** Emails */
            readonly emails: readonly string[];
            /** Expires At */
            readonly expires_at: string | null;
            /** Is Active */
            readonly is_active: boolean;
            /** Is Editor */
            readonly is_editor: boolean;
            readonly person: components["schemas"]["PersonRef"];
        };
        /**
         * MemberSet
         * @description How somebody is in a group: with a say in who else is, and until when; without `expires_at` there is no end.
         */
        readonly MemberSet: {
            /** Expires At */
            readonly expires_at?: string | null;
            /**
             * Is Editor
             * @default false
             */
            readonly is_editor: boolean;
        };
        /**
         * MeRead
         * @description Who the server takes the caller for: `GET /me`. `is_admin`: with the power of an admin, by this credential.
         */
        readonly MeRead: {
            readonly credential: components["schemas"]["CredentialRead"];
            /** Emails */
            readonly emails: readonly string[];
            /** Groups */
            readonly groups: readonly string[];
            /** Is Admin */
            readonly is_admin: boolean;
            readonly person: components["schemas"]["PersonRef"];
        };
        /**
         * MetadataField
         * @description One field that a project declares.
         *
         *     `unit` belongs to numbers, `pattern` (Rust regex syntax, whole value) to strings, `choices` to choices.
         */
        readonly MetadataField: {
            /** Choices */
            readonly choices?: readonly string[] | null;
            /** Default */
            readonly default?: boolean | number | string | components["schemas"]["Location"] | null;
            /**
             * Description
             * @default
             */
            readonly description: string;
            /** Name */
            readonly name: string;
            /** Pattern */
            readonly pattern?: string | null;
            /**
             * Required
             * @default false
             */
            readonly required: boolean;
            readonly type: components["schemas"]["FieldType"];
            /** Unit */
            readonly unit?: string | null;
        };
        /**
         * MetadataFields
         * @description All fields that a project declares, as in `fields.yaml`.
         *
         *     ```yaml
         *     undeclared: refuse
         *     fields:
         *       - {name: robot, type: choice, choices: [anymal, spot], required: true}
         *       - {name: temperature, type: number, unit: degC}
         *     ```
         */
        readonly MetadataFields: {
            /**
             * Fields
             * @default []
             */
            readonly fields: readonly components["schemas"]["MetadataField"][];
            /** @default accept */
            readonly undeclared: components["schemas"]["Undeclared"];
        };
        /**
         * MissionCreate
         * @description A mission to make; `metadata_yaml` is kept to the letter and must satisfy the project's fields.
         */
        readonly MissionCreate: {
            /** Metadata Yaml */
            readonly metadata_yaml?: string | null;
            /** Name */
            readonly name: string;
            /**
             * Notes
             * @default
             */
            readonly notes: string;
        };
        /**
         * MissionRead
         * @description A mission and what it amounts to.
         *
         *     `start_ns` and `end_ns` (log clock, since 1970, UTC) span its recordings without suspect stamps.
         *     `metadata_problems` names what no longer satisfies the project's fields. `pending_file_count` counts the files whose
         *     content nobody has read yet, those included that only the proof will read; `recordings_current` says whether
         *     recordings and span follow from today's files. `right` is the asker's own on it, from wherever it comes.
         */
        readonly MissionRead: {
            /** Completed At */
            readonly completed_at: string | null;
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            readonly created_by: components["schemas"]["PersonRef"];
            /** End Ns */
            readonly end_ns: number | null;
            /** File Count */
            readonly file_count: number;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Message Count */
            readonly message_count: number;
            /** Metadata */
            readonly metadata: {
                readonly [key: string]: components["schemas"]["JsonValue"];
            };
            /** Metadata Problems */
            readonly metadata_problems: readonly components["schemas"]["FieldProblem"][];
            /** Metadata Yaml */
            readonly metadata_yaml: string | null;
            /** Name */
            readonly name: string;
            /** Notes */
            readonly notes: string;
            /** Pending File Count */
            readonly pending_file_count: number;
            readonly project: components["schemas"]["ProjectRef"];
            /** Recordings Current */
            readonly recordings_current: boolean;
            readonly right: components["schemas"]["Right"];
            /** Size Bytes */
            readonly size_bytes: number;
            /** Start Ns */
            readonly start_ns: number | null;
        };
        /**
         * MissionRef
         * @description A mission, as named beside what it holds.
         */
        readonly MissionRef: {
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Name */
            readonly name: string;
            readonly project: components["schemas"]["ProjectRef"];
        };
        /**
         * MissionSort
         * @description Orders of a list of missions.
         * @enum {string}
         */
        readonly MissionSort: "name" | "-name" | "created" | "-created" | "start" | "-start";
        /**
         * MissionTemplate
         * @description The YAML to fill in for a project's next mission.
         */
        readonly MissionTemplate: {
            readonly prefilled_from: components["schemas"]["MissionRef"] | null;
            /** Yaml */
            readonly yaml: string;
        };
        /**
         * MissionUpdate
         * @description What to change of a mission; what is left out stays. A new `project_id` moves it, files and all.
         */
        readonly MissionUpdate: {
            /** Completed */
            readonly completed?: boolean | null;
            /** Metadata Yaml */
            readonly metadata_yaml?: string | null;
            /** Name */
            readonly name?: string | null;
            /** Notes */
            readonly notes?: string | null;
            /** Project Id */
            readonly project_id?: string | null;
        };
        /**
         * NotCompleted
         * @description The upload could not be finished; the problem says why and what to do.
         */
        readonly NotCompleted: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            readonly outcome: "refused";
            readonly problem: components["schemas"]["ProblemDocument"];
            /**
             * Upload Id
             * Format: uuid
             */
            readonly upload_id: string;
        };
        /**
         * OneTimeLink
         * @description A link that is good once, until then.
         */
        readonly OneTimeLink: {
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
            /** Url */
            readonly url: string;
        };
        /** Page[AccessRead] */
        readonly Page_AccessRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["AccessRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[AuditRead] */
        readonly Page_AuditRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["AuditRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[FileRead] */
        readonly Page_FileRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["FileRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[GrantRead] */
        readonly Page_GrantRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["GrantRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[GroupRead] */
        readonly Page_GroupRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["GroupRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[MemberRead] */
        readonly Page_MemberRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["MemberRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[MissionRead] */
        readonly Page_MissionRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["MissionRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[PersonRead] */
        readonly Page_PersonRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["PersonRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[ProjectRead] */
        readonly Page_ProjectRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["ProjectRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[RecordingRead] */
        readonly Page_RecordingRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["RecordingRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[SessionRead] */
        readonly Page_SessionRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["SessionRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[ShareRead] */
        readonly Page_ShareRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["ShareRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[TokenRead] */
        readonly Page_TokenRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["TokenRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[TopicRead] */
        readonly Page_TopicRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["TopicRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[TrashRead] */
        readonly Page_TrashRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["TrashRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /** Page[UploadRead] */
        readonly Page_UploadRead_: {
            /** Items */
            readonly items: readonly components["schemas"]["UploadRead"][];
            /** Next */
            readonly next?: string | null;
            /** Total */
            readonly total?: number | null;
        };
        /**
         * PartsSign
         * @description Parts to sign, of one or several uploads: many small files take one request.
         */
        readonly PartsSign: {
            /** Parts */
            readonly parts: readonly components["schemas"]["PartToSign"][];
        };
        /**
         * PartToSign
         * @description A part about to be sent, with its checksum in lower-case hex (of the kind that the upload names).
         */
        readonly PartToSign: {
            /** Checksum */
            readonly checksum: string;
            /** Number */
            readonly number: number;
            /**
             * Upload Id
             * Format: uuid
             */
            readonly upload_id: string;
        };
        /**
         * PasswordChange
         * @description Choose a new password: `POST /auth/password/change`. Other browsers are signed out.
         */
        readonly PasswordChange: {
            /** New Password */
            readonly new_password: string;
            /** Old Password */
            readonly old_password: string;
        };
        /**
         * PasswordReset
         * @description Choose a new password by an admin's link: `POST /auth/reset`.
         */
        readonly PasswordReset: {
            /** Code */
            readonly code: string;
            /** Password */
            readonly password: string;
        };
        /**
         * PasswordSignIn
         * @description Sign in with a local account: `POST /auth/password`.
         */
        readonly PasswordSignIn: {
            /** Email */
            readonly email: string;
            /** Password */
            readonly password: string;
        };
        /**
         * PersonRead
         * @description A person. `emails` are their verified addresses, for themselves, admins, and editors of a group that they are in.
         *
         *     `deactivated_at` is when they left; only admins see those who did.
         */
        readonly PersonRead: {
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            /** Deactivated At */
            readonly deactivated_at: string | null;
            /** Emails */
            readonly emails: readonly string[];
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Is Admin */
            readonly is_admin: boolean;
            /** Name */
            readonly name: string;
        };
        /**
         * PersonRef
         * @description A person, as named beside what they did.
         */
        readonly PersonRef: {
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Name */
            readonly name: string;
        };
        /**
         * Present
         * @description The mission already has this very file under this name: nothing to send. `file` is null for who may not read.
         */
        readonly Present: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            readonly decision: "present";
            readonly file: components["schemas"]["FileRead"] | null;
        };
        /**
         * ProblemDocument
         * @description A failure on the wire (RFC 9457); the fields of the error's class stand beside these.
         */
        readonly ProblemDocument: {
            readonly code: components["schemas"]["ErrorCode"];
            /** Detail */
            readonly detail: string;
            /** Request Id */
            readonly request_id?: string | null;
            /** Status */
            readonly status: number;
            /** Title */
            readonly title: string;
            /** Type */
            readonly type: string;
        } & {
            readonly [key: string]: unknown;
        };
        /**
         * ProjectCreate
         * @description A project to make; `fields_yaml` is the text of a `fields.yaml`, read and judged by the server.
         */
        readonly ProjectCreate: {
            /**
             * Description
             * @default
             */
            readonly description: string;
            /** Fields Yaml */
            readonly fields_yaml?: string | null;
            /** Name */
            readonly name: string;
        };
        /**
         * ProjectRead
         * @description A project and what it amounts to. Counts leave out what is in the trash; `right` is the asker's own on it.
         *
         *     What is used, which the quotas bound, is the files and the uploads under way.
         */
        readonly ProjectRead: {
            /** Citation */
            readonly citation: string;
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            readonly created_by: components["schemas"]["PersonRef"];
            /** Description */
            readonly description: string;
            /** Duration Ns */
            readonly duration_ns: number;
            /** File Count */
            readonly file_count: number;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Is Public */
            readonly is_public: boolean;
            /** Licence */
            readonly licence: string;
            readonly metadata_fields: components["schemas"]["MetadataFields"];
            /** Mission Count */
            readonly mission_count: number;
            /** Name */
            readonly name: string;
            /** Quota Bytes */
            readonly quota_bytes: number | null;
            /** Quota Files */
            readonly quota_files: number | null;
            readonly right: components["schemas"]["Right"];
            /** Size Bytes */
            readonly size_bytes: number;
            /** Unsatisfied Mission Count */
            readonly unsatisfied_mission_count: number;
            /** Used Bytes */
            readonly used_bytes: number;
            /** Used Files */
            readonly used_files: number;
        };
        /**
         * ProjectRef
         * @description A project, as named beside what it holds.
         */
        readonly ProjectRef: {
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Name */
            readonly name: string;
        };
        /**
         * ProjectSort
         * @description Orders of a list of projects; names by `COLLATE "C"`.
         * @enum {string}
         */
        readonly ProjectSort: "name" | "-name" | "created" | "-created";
        /**
         * ProjectUpdate
         * @description What to change of a project; what is left out stays.
         *
         *     Anybody may read a public project, with or without an account. A quota of null is none; admins set quotas.
         */
        readonly ProjectUpdate: {
            /** Citation */
            readonly citation?: string | null;
            /** Description */
            readonly description?: string | null;
            /** Fields Yaml */
            readonly fields_yaml?: string | null;
            /** Is Public */
            readonly is_public?: boolean | null;
            /** Licence */
            readonly licence?: string | null;
            /** Name */
            readonly name?: string | null;
            /** Quota Bytes */
            readonly quota_bytes?: number | null;
            /** Quota Files */
            readonly quota_files?: number | null;
        };
        /**
         * ProviderBegin
         * @description Begin to sign in by a provider: `POST /auth/providers/{name}`; `POST /auth/link/{name}` to add it to oneself.
         */
        readonly ProviderBegin: {
            /**
             * Return To
             * @default /
             */
            readonly return_to: string;
        };
        /**
         * ProviderBegun
         * @description Where the browser goes next.
         */
        readonly ProviderBegun: {
            /** Url */
            readonly url: string;
        };
        /**
         * ProviderRef
         * @description Somebody who says who people are; `name` is what requests call them.
         */
        readonly ProviderRef: {
            /** Name */
            readonly name: string;
            /** Title */
            readonly title: string;
        };
        /**
         * ReadDepth
         * @description How content was read: by the file's own index, or every byte of it.
         * @enum {string}
         */
        readonly ReadDepth: "summary" | "scan";
        /**
         * RecordingRead
         * @description One logical capture of 1..n files. `missing` are members that its metadata names and the mission lacks.
         *
         *     `content` is that of all members together: `recovered` where something can be read and something is damaged or
         *     missing. `problems` are those of the whole; what is odd inside one file is among the problems of that file.
         */
        readonly RecordingRead: {
            readonly content: components["schemas"]["ContentState"];
            /** Content Reason */
            readonly content_reason: string | null;
            /** End Ns */
            readonly end_ns: number | null;
            /** File Ids */
            readonly file_ids: readonly string[];
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Kind */
            readonly kind: string;
            readonly lost: components["schemas"]["FileLoss"] | null;
            /** Message Count */
            readonly message_count: number | null;
            /** Missing */
            readonly missing: readonly string[];
            readonly mission: components["schemas"]["MissionRef"];
            /** Name */
            readonly name: string;
            /** Paths */
            readonly paths: readonly string[];
            /** Problems */
            readonly problems: readonly components["schemas"]["FileProblem"][];
            /** Size Bytes */
            readonly size_bytes: number;
            /** Start Ns */
            readonly start_ns: number | null;
            /** Surplus */
            readonly surplus: readonly string[];
        };
        /**
         * Refused
         * @description This file cannot be uploaded; the others can.
         */
        readonly Refused: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            readonly decision: "refused";
            /** Path */
            readonly path: string;
            readonly problem: components["schemas"]["ProblemDocument"];
        };
        /**
         * Right
         * @description What somebody may do with a project or a mission. Each contains those before it; compare by `level`.
         * @enum {string}
         */
        readonly Right: "READ" | "CREATE" | "WRITE" | "DELETE";
        /**
         * Scope
         * @description What a token may be used for, within what its person may do.
         *
         *     `read`: see and download. `upload`: make missions and send files, seeing no more than names. `write`: change and
         *     delete, with `read` and `upload`. `run`: start and cancel runs. `admin`: all of these, grant rights, and use the
         *     power of an admin.
         * @enum {string}
         */
        readonly Scope: "read" | "upload" | "write" | "run" | "admin";
        /**
         * Send
         * @description Send the parts that `upload` does not list.
         */
        readonly Send: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            readonly decision: "send";
            readonly upload: components["schemas"]["UploadRead"];
        };
        /**
         * ServiceRead
         * @description What a server says of itself to somebody it knows: `GET /api/v1/service`.
         */
        readonly ServiceRead: {
            /** Checksum */
            readonly checksum: string;
            readonly person: components["schemas"]["PersonRef"];
            /** Public Url */
            readonly public_url: string;
            /** Store Url */
            readonly store_url: string;
            /** Version */
            readonly version: string;
        };
        /**
         * SessionRead
         * @description A browser that one is signed in with: `GET /me/sessions`; `DELETE /me/sessions/{id}` signs it out.
         */
        readonly SessionRead: {
            /** Address */
            readonly address: string | null;
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Is Current */
            readonly is_current: boolean;
            /**
             * Last Used At
             * Format: date-time
             */
            readonly last_used_at: string;
            /** User Agent */
            readonly user_agent: string | null;
            /** Way */
            readonly way: string;
        };
        /**
         * ShareCreate
         * @description A link to make: to files of the mission, or with `file_ids` null to all that is in it now and later.
         */
        readonly ShareCreate: {
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
            /** File Ids */
            readonly file_ids?: readonly string[] | null;
            /** Name */
            readonly name: string;
        };
        /**
         * SharedRead
         * @description What a link shows, as seen by whoever has it: `file_count` and `size_bytes` of what it shows now.
         */
        readonly SharedRead: {
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
            /** File Count */
            readonly file_count: number;
            /** Is Whole */
            readonly is_whole: boolean;
            readonly mission: components["schemas"]["MissionRef"];
            /** Name */
            readonly name: string;
            /** Size Bytes */
            readonly size_bytes: number;
        };
        /**
         * ShareMade
         * @description A new link with its secret, which nobody can show again. `url` holds the secret, too.
         */
        readonly ShareMade: {
            /** Secret */
            readonly secret: string;
            readonly share: components["schemas"]["ShareRead"];
            /** Url */
            readonly url: string;
        };
        /**
         * ShareRead
         * @description A link without its secret; `prefix` is how that begins.
         *
         *     `file_count` is null for a link to a whole mission. Downloads are addresses given out, a file each, and their bytes.
         */
        readonly ShareRead: {
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            readonly created_by: components["schemas"]["PersonRef"];
            /** Download Bytes */
            readonly download_bytes: number;
            /** Download Count */
            readonly download_count: number;
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
            /** File Count */
            readonly file_count: number | null;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Last Used At */
            readonly last_used_at: string | null;
            readonly mission: components["schemas"]["MissionRef"];
            /** Name */
            readonly name: string;
            /** Prefix */
            readonly prefix: string;
            /** Revoked At */
            readonly revoked_at: string | null;
        };
        /**
         * SignedIn
         * @description A new token, told this once, and whose it is.
         */
        readonly SignedIn: {
            /** Expires At */
            readonly expires_at: string | null;
            readonly person: components["schemas"]["PersonRef"];
            /** Token */
            readonly token: string;
        };
        /**
         * SignedPart
         * @description PUT the part's bytes to `url` with exactly these headers, before `expires_at`.
         */
        readonly SignedPart: {
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
            /** Headers */
            readonly headers: {
                readonly [key: string]: string;
            };
            /** Number */
            readonly number: number;
            /**
             * Upload Id
             * Format: uuid
             */
            readonly upload_id: string;
            /** Url */
            readonly url: string;
        };
        /**
         * SignedParts
         * @description Signed parts, in the order asked; asking also renews the leases of their uploads.
         */
        readonly SignedParts: {
            /** Items */
            readonly items: readonly components["schemas"]["SignedPart"][];
        };
        /**
         * SignInWays
         * @description How one may sign in here: `GET /auth/ways`. `claim`: nobody is admin yet, and a code from the log makes one.
         */
        readonly SignInWays: {
            /** Claim */
            readonly claim: boolean;
            /** Password */
            readonly password: boolean;
            /** Providers */
            readonly providers: readonly components["schemas"]["ProviderRef"][];
        };
        /**
         * StatsRead
         * @description Statistics by `by` (`project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`), and in all.
         */
        readonly StatsRead: {
            /** By */
            readonly by: string;
            /** Rows */
            readonly rows: readonly components["schemas"]["StatsRow"][];
            readonly total: components["schemas"]["StatsRow"];
        };
        /**
         * StatsRow
         * @description One group. `duration_ns` sums the recordings' spans; files in the trash do not count.
         *
         *     Grouped by topic or message type, a recording counts in each of its groups, and `messages` are that group's own.
         */
        readonly StatsRow: {
            /** Duration Ns */
            readonly duration_ns: number;
            /** Files */
            readonly files: number;
            /** Group */
            readonly group: string | null;
            /** Messages */
            readonly messages: number;
            /** Missions */
            readonly missions: number;
            /** Recordings */
            readonly recordings: number;
            /** Size Bytes */
            readonly size_bytes: number;
        };
        /**
         * TokenCreate
         * @description A token to make. Without `scopes`, those usual for its kind; without limits, it reaches what its person reaches.
         *
         *     A robot's token is limited to projects or missions and is never for administration. A runner's is for runs alone.
         */
        readonly TokenCreate: {
            /** Expires At */
            readonly expires_at?: string | null;
            /** @default personal */
            readonly kind: components["schemas"]["TokenKind"];
            /**
             * Mission Ids
             * @default []
             */
            readonly mission_ids: readonly string[];
            /** Name */
            readonly name: string;
            /**
             * Project Ids
             * @default []
             */
            readonly project_ids: readonly string[];
            /** Scopes */
            readonly scopes?: readonly components["schemas"]["Scope"][] | null;
        };
        /**
         * TokenKind
         * @description Who carries a token: a person's script, a robot, or a runner of actions.
         * @enum {string}
         */
        readonly TokenKind: "personal" | "robot" | "runner";
        /**
         * TokenMade
         * @description A new token with its secret, which nobody can show again.
         */
        readonly TokenMade: {
            /** Secret */
            readonly secret: string;
            readonly token: components["schemas"]["TokenRead"];
        };
        /**
         * TokenPlace
         * @description A project or mission that a token is limited to. `name` is null where whoever asks may not see it (any more).
         */
        readonly TokenPlace: {
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Name */
            readonly name: string | null;
            /** Noun */
            readonly noun: string;
        };
        /**
         * TokenRead
         * @description A token without its secret; `prefix` is how that begins.
         *
         *     `limits` are null where it reaches what its person reaches, and empty where all it was limited to is gone.
         *     `last_used_at` is exact to a minute.
         */
        readonly TokenRead: {
            /**
             * Created At
             * Format: date-time
             */
            readonly created_at: string;
            /** Expires At */
            readonly expires_at: string | null;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            readonly kind: components["schemas"]["TokenKind"];
            /** Last Used At */
            readonly last_used_at: string | null;
            /** Limits */
            readonly limits: readonly components["schemas"]["TokenPlace"][] | null;
            /** Name */
            readonly name: string;
            readonly person: components["schemas"]["PersonRef"];
            /** Prefix */
            readonly prefix: string;
            /** Revoked At */
            readonly revoked_at: string | null;
            /** Scopes */
            readonly scopes: readonly components["schemas"]["Scope"][];
        };
        /**
         * TopicRead
         * @description One topic of one recording file. Times: integer nanoseconds of the log clock; `rate_hz` = (count - 1) / span.
         */
        readonly TopicRead: {
            /** Count */
            readonly count: number | null;
            /**
             * File Id
             * Format: uuid
             */
            readonly file_id: string;
            /** First Ns */
            readonly first_ns: number | null;
            /** Head Gap Ns */
            readonly head_gap_ns: number | null;
            /** Last Ns */
            readonly last_ns: number | null;
            /** Longest Gap Ns */
            readonly longest_gap_ns: number | null;
            /** Message Encoding */
            readonly message_encoding: string | null;
            /** Message Type */
            readonly message_type: string | null;
            /** Name */
            readonly name: string;
            /** Out Of Order Count */
            readonly out_of_order_count: number | null;
            /** Rate Hz */
            readonly rate_hz: number | null;
            /** Schema Encoding */
            readonly schema_encoding: string | null;
            /** Schema Name */
            readonly schema_name: string | null;
            /** Stored Bytes */
            readonly stored_bytes: number | null;
            /** Tail Gap Ns */
            readonly tail_gap_ns: number | null;
        };
        /**
         * TrashNoun
         * @description What can lie in the trash.
         * @enum {string}
         */
        readonly TrashNoun: "project" | "mission" | "file";
        /**
         * TrashRead
         * @description Something deleted. `place` is what held it: the project of a mission, project and mission of a file.
         *
         *     A mission that was deleted with its project is not listed by itself; it comes back with the project.
         */
        readonly TrashRead: {
            /**
             * Deleted At
             * Format: date-time
             */
            readonly deleted_at: string;
            readonly deleted_by: components["schemas"]["PersonRef"];
            /** File Count */
            readonly file_count: number;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /** Name */
            readonly name: string;
            readonly noun: components["schemas"]["TrashNoun"];
            /** Place */
            readonly place: string;
            /** Size Bytes */
            readonly size_bytes: number;
            /**
             * Swept After
             * Format: date-time
             */
            readonly swept_after: string;
        };
        /**
         * Undeclared
         * @description What a project does with metadata keys that none of its fields declares.
         * @enum {string}
         */
        readonly Undeclared: "accept" | "refuse";
        /**
         * UploadBegin
         * @description Files to upload into one mission.
         */
        readonly UploadBegin: {
            /** Files */
            readonly files: readonly components["schemas"]["UploadFile"][];
        };
        /**
         * UploadDecisions
         * @description One decision a file, in the order asked.
         */
        readonly UploadDecisions: {
            /** Items */
            readonly items: readonly (components["schemas"]["Present"] | components["schemas"]["Linked"] | components["schemas"]["HashFirst"] | components["schemas"]["Send"] | components["schemas"]["Refused"])[];
        };
        /**
         * UploadFile
         * @description One file that a client wants to upload. Hashes where they are known already, lower-case hex.
         *
         *     Small files come with their sha256 at once, so that most are decided in one answer.
         *     `upload_id` resumes an earlier upload of the same path and size.
         */
        readonly UploadFile: {
            /** Path */
            readonly path: string;
            /** Sha256 */
            readonly sha256?: string | null;
            /** Size Bytes */
            readonly size_bytes: number;
            /** Upload Id */
            readonly upload_id?: string | null;
        };
        /**
         * UploadFinish
         * @description An upload whose parts are all sent; the hashes are of the whole file.
         */
        readonly UploadFinish: {
            /** Crc64Nvme */
            readonly crc64nvme: string;
            /** Sha256 */
            readonly sha256: string;
            /**
             * Upload Id
             * Format: uuid
             */
            readonly upload_id: string;
        };
        /**
         * UploadOutcomes
         * @description One outcome an upload, in the order asked.
         */
        readonly UploadOutcomes: {
            /** Items */
            readonly items: readonly (components["schemas"]["Completed"] | components["schemas"]["NotCompleted"])[];
        };
        /**
         * UploadRead
         * @description An upload under way. `parts` are those the store holds, in order; empty for one that has just begun.
         */
        readonly UploadRead: {
            readonly checksum: components["schemas"]["ChecksumKind"];
            /**
             * Expires At
             * Format: date-time
             */
            readonly expires_at: string;
            /**
             * Id
             * Format: uuid
             */
            readonly id: string;
            /**
             * Lease Ends At
             * Format: date-time
             */
            readonly lease_ends_at: string;
            /**
             * Mission Id
             * Format: uuid
             */
            readonly mission_id: string;
            /** Part Size Bytes */
            readonly part_size_bytes: number;
            /**
             * Parts
             * @default []
             */
            readonly parts: readonly components["schemas"]["HeldPart"][];
            /** Path */
            readonly path: string;
            /** Size Bytes */
            readonly size_bytes: number;
            readonly state: components["schemas"]["UploadState"];
        };
        /**
         * UploadsComplete
         * @description Uploads to finish.
         */
        readonly UploadsComplete: {
            /** Uploads */
            readonly uploads: readonly components["schemas"]["UploadFinish"][];
        };
        /**
         * UploadState
         * @description `open` takes parts, `completing` is being finished by the server, the others are ends.
         * @enum {string}
         */
        readonly UploadState: "open" | "completing" | "done" | "aborted" | "expired";
    };
    responses: never;
    parameters: never;
    requestBodies: never;
    headers: never;
    pathItems: never;
}
export type $defs = Record<string, never>;
export interface operations {
    readonly list_audit_events: {
        readonly parameters: {
            readonly query?: {
                readonly as_admin?: boolean | null;
                readonly cursor?: string | null;
                readonly limit?: number;
                readonly mission_id?: string | null;
                readonly noun?: string | null;
                readonly noun_id?: string | null;
                readonly operation?: string | null;
                readonly person?: string | null;
                readonly person_id?: string | null;
                readonly project_id?: string | null;
                readonly share_id?: string | null;
                readonly since?: string | null;
                readonly token?: string | null;
                readonly token_id?: string | null;
                readonly until?: string | null;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_AuditRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly export_audit_events: {
        readonly parameters: {
            readonly query?: {
                readonly as_admin?: boolean | null;
                readonly mission_id?: string | null;
                readonly noun?: string | null;
                readonly noun_id?: string | null;
                readonly operation?: string | null;
                readonly person?: string | null;
                readonly person_id?: string | null;
                readonly project_id?: string | null;
                readonly share_id?: string | null;
                readonly since?: string | null;
                readonly token?: string | null;
                readonly token_id?: string | null;
                readonly until?: string | null;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description One event a line. */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/jsonl": string;
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly claim_server: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["Claim"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure, by its code: not_authenticated, sign_in_failed. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, sign_in_refused. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited, slow_down. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly approve_cli_login: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["LoopbackApproval"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["LoopbackApproved"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly exchange_cli_code: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["CliExchange"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["SignedIn"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, sign_in_refused. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: sign_in_expired. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly look_at_code: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["CodeSignIn"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["CodeRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly begin_device_login: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["DeviceBegin"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["DeviceCode"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly approve_device_login: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["DeviceDecision"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["DeviceRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly deny_device_login: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["DeviceDecision"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["DeviceRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly look_at_device_login: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["DeviceDecision"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["DeviceRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly exchange_device_code: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["DeviceExchange"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["SignedIn"];
                };
            };
            /** @description A failure, by its code: sign_in_pending. */
            readonly 400: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, sign_in_denied, sign_in_refused. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: sign_in_expired. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: slow_down, rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly accept_invitation: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["InvitationAccept"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure, by its code: not_authenticated, sign_in_failed. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, sign_in_refused. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited, slow_down. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly sign_in_by_link: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["CodeSignIn"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure, by its code: not_authenticated, sign_in_failed. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, sign_in_refused. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited, slow_down. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_owner_link: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["OneTimeLink"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly sign_in_by_password: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["PasswordSignIn"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure, by its code: not_authenticated, sign_in_failed. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, sign_in_refused. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited, slow_down. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly change_password: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["PasswordChange"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated, sign_in_failed. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, sign_in_refused. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited, slow_down. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly begin_provider_sign_in: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly name: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["ProviderBegin"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["ProviderBegun"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable, provider_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly link_provider: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly name: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["ProviderBegin"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["ProviderBegun"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable, provider_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly reset_password: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["PasswordReset"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure, by its code: not_authenticated, sign_in_failed. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, sign_in_refused. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: code_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited, slow_down. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly sign_out: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_sign_in_ways: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["SignInWays"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_files: {
        readonly parameters: {
            readonly query?: {
                readonly content?: readonly components["schemas"]["ContentState"][];
                readonly count?: boolean;
                readonly cursor?: string | null;
                readonly format?: readonly string[];
                readonly label?: readonly string[];
                readonly limit?: number;
                readonly max_size_bytes?: number | null;
                readonly message_type?: readonly string[];
                readonly min_size_bytes?: number | null;
                readonly mission?: string | null;
                readonly mission_id?: string | null;
                readonly path?: readonly string[];
                readonly project?: string | null;
                readonly project_id?: string | null;
                readonly recorded_after?: string | null;
                readonly recorded_before?: string | null;
                readonly recording_id?: string | null;
                readonly sort?: components["schemas"]["FileSort"];
                readonly state?: readonly components["schemas"]["BlobState"][];
                readonly text?: string | null;
                readonly topic?: readonly string[];
                readonly where?: readonly string[];
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_FileRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_query, invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_file: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly file_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["FileRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly delete_file: {
        readonly parameters: {
            readonly query?: {
                readonly dry_run?: boolean;
            };
            readonly header?: never;
            readonly path: {
                readonly file_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Deleted"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly update_file: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly file_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["FileUpdate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["FileRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken, path_conflict. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: quota_exceeded. */
            readonly 507: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly prove_file: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly file_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 202: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["FileRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_file_topics: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path: {
                readonly file_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_TopicRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly download_files: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["DownloadRequest"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["DownloadLinks"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: file_unavailable. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_groups: {
        readonly parameters: {
            readonly query?: {
                readonly count?: boolean;
                readonly cursor?: string | null;
                readonly limit?: number;
                readonly name?: string | null;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_GroupRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_group: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["GroupCreate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["GroupRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_group: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly group_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["GroupRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly delete_group: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly group_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: group_fixed, last_owner, last_admin. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly update_group: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly group_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["GroupUpdate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["GroupRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken, group_fixed. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_group_members: {
        readonly parameters: {
            readonly query?: {
                readonly count?: boolean;
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path: {
                readonly group_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_MemberRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly set_group_member: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly group_id: string;
                readonly person_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["MemberSet"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["MemberRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden, right_exceeded. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: group_fixed, last_owner, last_admin. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly remove_group_member: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly group_id: string;
                readonly person_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: group_fixed, last_owner, last_admin. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_me: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["MeRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_identities: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": readonly components["schemas"]["IdentityRead"][];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_sessions: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_SessionRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly end_all_sessions: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly end_session: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly session_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_missions: {
        readonly parameters: {
            readonly query?: {
                readonly completed?: boolean | null;
                readonly count?: boolean;
                readonly cursor?: string | null;
                readonly limit?: number;
                readonly message_type?: readonly string[];
                readonly name?: string | null;
                readonly project?: string | null;
                readonly project_id?: string | null;
                readonly recorded_after?: string | null;
                readonly recorded_before?: string | null;
                readonly satisfied?: boolean | null;
                readonly sort?: components["schemas"]["MissionSort"];
                readonly text?: string | null;
                readonly topic?: readonly string[];
                readonly where?: readonly string[];
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_MissionRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_query, invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_mission: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["MissionRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly delete_mission: {
        readonly parameters: {
            readonly query?: {
                readonly dry_run?: boolean;
            };
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Deleted"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly update_mission: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["MissionUpdate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["MissionRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: yaml_invalid, metadata_invalid, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: quota_exceeded. */
            readonly 507: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_mission_access: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_AccessRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_mission_grants: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_GrantRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_mission_grant: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["GrantCreate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["GrantRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, right_exceeded, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: last_owner. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly delete_mission_grant: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly grant_id: string;
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: last_owner. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly update_mission_grant: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly grant_id: string;
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["GrantUpdate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["GrantRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, right_exceeded, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: last_owner. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_recordings: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_RecordingRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_share: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["ShareCreate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["ShareMade"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_uploads: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_UploadRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly begin_uploads: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly mission_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["UploadBegin"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["UploadDecisions"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable, store_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: quota_exceeded. */
            readonly 507: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_people: {
        readonly parameters: {
            readonly query?: {
                readonly active?: boolean | null;
                readonly count?: boolean;
                readonly cursor?: string | null;
                readonly limit?: number;
                readonly text?: string | null;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_PersonRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_person: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly person_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["PersonRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly make_admin: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly person_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["PersonRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly unmake_admin: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly person_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["PersonRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: last_admin. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly deactivate_person: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly person_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Departure"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: last_admin. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly reactivate_person: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly person_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["PersonRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_reset_link: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly person_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["OneTimeLink"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly invite_person: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["InvitationCreate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["OneTimeLink"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_projects: {
        readonly parameters: {
            readonly query?: {
                readonly count?: boolean;
                readonly cursor?: string | null;
                readonly limit?: number;
                readonly name?: string | null;
                readonly sort?: components["schemas"]["ProjectSort"];
                readonly text?: string | null;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_ProjectRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_query, invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_project: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["ProjectCreate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["ProjectRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: yaml_invalid, fields_invalid, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_project: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["ProjectRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly delete_project: {
        readonly parameters: {
            readonly query?: {
                readonly dry_run?: boolean;
            };
            readonly header?: never;
            readonly path: {
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Deleted"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly update_project: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["ProjectUpdate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["ProjectRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: yaml_invalid, fields_invalid, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_project_access: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path: {
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_AccessRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_project_grants: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
            };
            readonly header?: never;
            readonly path: {
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_GrantRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_project_grant: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["GrantCreate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["GrantRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, right_exceeded, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: last_owner. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly delete_project_grant: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly grant_id: string;
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: last_owner. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly update_project_grant: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly grant_id: string;
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["GrantUpdate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["GrantRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, right_exceeded, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: last_owner. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_mission: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["MissionCreate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["MissionRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: yaml_invalid, metadata_invalid, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_mission_template: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly project_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["MissionTemplate"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_recording: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly recording_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["RecordingRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_service: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["ServiceRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_share: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["SharedRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_shares: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly ended?: boolean;
                readonly limit?: number;
                readonly mission_id?: string | null;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_ShareRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly revoke_share: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly share_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_stats: {
        readonly parameters: {
            readonly query?: {
                readonly by?: string;
                readonly content?: readonly components["schemas"]["ContentState"][];
                readonly format?: readonly string[];
                readonly label?: readonly string[];
                readonly max_size_bytes?: number | null;
                readonly message_type?: readonly string[];
                readonly min_size_bytes?: number | null;
                readonly mission?: string | null;
                readonly mission_id?: string | null;
                readonly path?: readonly string[];
                readonly project?: string | null;
                readonly project_id?: string | null;
                readonly recorded_after?: string | null;
                readonly recorded_before?: string | null;
                readonly recording_id?: string | null;
                readonly state?: readonly components["schemas"]["BlobState"][];
                readonly text?: string | null;
                readonly topic?: readonly string[];
                readonly where?: readonly string[];
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["StatsRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_query, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_tokens: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly ended?: boolean;
                readonly everybody?: boolean;
                readonly limit?: number;
                readonly person_id?: string | null;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_TokenRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly create_token: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["TokenCreate"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 201: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["TokenMade"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden, token_too_wide. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly revoke_token: {
        readonly parameters: {
            readonly query?: {
                readonly made?: components["schemas"]["Made"];
            };
            readonly header?: never;
            readonly path: {
                readonly token_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_topics: {
        readonly parameters: {
            readonly query?: {
                readonly content?: readonly components["schemas"]["ContentState"][];
                readonly count?: boolean;
                readonly cursor?: string | null;
                readonly format?: readonly string[];
                readonly label?: readonly string[];
                readonly limit?: number;
                readonly max_size_bytes?: number | null;
                readonly message_type?: readonly string[];
                readonly min_size_bytes?: number | null;
                readonly mission?: string | null;
                readonly mission_id?: string | null;
                readonly path?: readonly string[];
                readonly project?: string | null;
                readonly project_id?: string | null;
                readonly recorded_after?: string | null;
                readonly recorded_before?: string | null;
                readonly recording_id?: string | null;
                readonly state?: readonly components["schemas"]["BlobState"][];
                readonly text?: string | null;
                readonly topic?: readonly string[];
                readonly where?: readonly string[];
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_TopicRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_query, invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: rate_limited. */
            readonly 429: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly list_trash: {
        readonly parameters: {
            readonly query?: {
                readonly cursor?: string | null;
                readonly limit?: number;
                readonly noun?: components["schemas"]["TrashNoun"] | null;
            };
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["Page_TrashRead_"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_cursor, invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly restore_from_trash: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly noun: components["schemas"]["TrashNoun"];
                readonly noun_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: name_taken, path_conflict. */
            readonly 409: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: quota_exceeded. */
            readonly 507: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly get_upload: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly upload_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["UploadRead"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable, store_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly abort_upload: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path: {
                readonly upload_id: string;
            };
            readonly cookie?: never;
        };
        readonly requestBody?: never;
        readonly responses: {
            /** @description Successful Response */
            readonly 204: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly complete_uploads: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["UploadsComplete"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["UploadOutcomes"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable, store_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    readonly sign_parts: {
        readonly parameters: {
            readonly query?: never;
            readonly header?: never;
            readonly path?: never;
            readonly cookie?: never;
        };
        readonly requestBody: {
            readonly content: {
                readonly "application/json": components["schemas"]["PartsSign"];
            };
        };
        readonly responses: {
            /** @description Successful Response */
            readonly 200: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/json": components["schemas"]["SignedParts"];
                };
            };
            /** @description A failure, by its code: not_authenticated. */
            readonly 401: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: scope_missing, forbidden. */
            readonly 403: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: not_found. */
            readonly 404: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: upload_gone. */
            readonly 410: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: body_too_large. */
            readonly 413: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: invalid_request. */
            readonly 422: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: internal_error. */
            readonly 500: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
            /** @description A failure, by its code: database_unavailable. */
            readonly 503: {
                headers: {
                    readonly [name: string]: unknown;
                };
                content: {
                    readonly "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
}
