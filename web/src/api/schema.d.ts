// Written by `npm run generate` from docs/openapi.json. Do not edit.

export interface paths {
    "/api/v1/actions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Actions
         * @description List actions by name: those of projects that you may read, and those of the whole lab.
         */
        get: operations["list_actions"];
        put?: never;
        /**
         * Create Action
         * @description Publish an action. The dependencies of its script are locked, unless it has a lock.
         */
        post: operations["create_action"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/actions/{action_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Action
         * @description Get an action with its latest version.
         */
        get: operations["get_action"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        /**
         * Update Action
         * @description Archive or restore an action. With If-Match, only if its ETag still matches.
         */
        patch: operations["update_action"];
        trace?: never;
    };
    "/api/v1/actions/{action_id}/versions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Action Versions
         * @description List the versions of an action, latest first.
         */
        get: operations["list_action_versions"];
        put?: never;
        /**
         * Publish Action Version
         * @description Publish a further version of an action, locked like the first. With If-Match, only if its ETag still matches.
         */
        post: operations["publish_action_version"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/actions/{action_id}/versions/{number}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Action Version
         * @description Get a version of an action, with its lock.
         */
        get: operations["get_action_version"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/admin/health": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Admin Health
         * @description Return the state of database, store and workers.
         */
        get: operations["get_admin_health"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/admin/jobs": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Admin Jobs
         * @description Return the queue, the jobs that wait for another attempt, and failed jobs.
         */
        get: operations["get_admin_jobs"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/admin/jobs/{job_id}/retry": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Retry Job
         * @description Requeue a failed job.
         */
        post: operations["retry_job"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/admin/jobs/retry": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Retry Jobs
         * @description Requeue all failed jobs.
         */
        post: operations["retry_jobs"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/admin/scrub": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Admin Scrub
         * @description Return the last comparison of the store with the database.
         */
        get: operations["get_admin_scrub"];
        put?: never;
        /**
         * Begin Scrub
         * @description Start a comparison of the store with the database.
         */
        post: operations["begin_scrub"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/admin/settings": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Admin Settings
         * @description Return the settings in force, without secrets.
         */
        get: operations["get_admin_settings"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/admin/status": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Admin Status
         * @description Return whether the server is healthy, what is full and when, and what needs an admin.
         */
        get: operations["get_admin_status"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/admin/storage": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Admin Storage
         * @description Return the contents of the store by state, and the free space if known.
         */
        get: operations["get_admin_storage"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/audit": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Audit Events
         * @description List audit events, latest first.
         */
        get: operations["list_audit_events"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/audit/export": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Export Audit Events
         * @description Return all events that match, oldest first, one JSON object a line.
         */
        get: operations["export_audit_events"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/bootstrap": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create First Admin
         * @description Become the first admin of a new server with the code from its log.
         */
        post: operations["bootstrap_admin"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/cli/approve": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Approve Cli Login
         * @description Approve a program on the machine of this browser.
         */
        post: operations["approve_cli_login"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/cli/token": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Exchange Cli Code
         * @description Exchange the code that the browser delivered to the loopback for a token.
         */
        post: operations["exchange_cli_code"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/codes": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Get Code
         * @description Return the purpose and recipient of a one-time link without using it.
         */
        post: operations["get_code"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/device": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Begin Device Login
         * @description Start a login with a code that is typed on another machine.
         */
        post: operations["begin_device_login"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/device/approve": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Approve Device Login
         * @description Approve the program that shows a code.
         */
        post: operations["approve_device_login"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/device/deny": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Deny Device Login
         * @description Deny the program that shows a code.
         */
        post: operations["deny_device_login"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/device/status": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Get Device Login
         * @description Return the program that shows a code.
         */
        post: operations["get_device_login"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/device/token": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Exchange Device Code
         * @description Exchange a device code for a token, once it is approved.
         */
        post: operations["exchange_device_code"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/invitation": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Accept Invitation
         * @description Create the account that an invitation is for, and sign in.
         */
        post: operations["accept_invitation"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/link": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Sign In By Link
         * @description Sign a browser in with a one-time link.
         */
        post: operations["sign_in_by_link"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/methods": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Sign In Methods
         * @description List the methods with which people sign in to this server.
         */
        get: operations["list_sign_in_methods"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/owner-link": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Owner Link
         * @description Create a link with which the owner of `klein up` signs in.
         */
        post: operations["create_owner_link"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/password": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Sign In By Password
         * @description Sign a browser in with a local account.
         */
        post: operations["sign_in_by_password"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/password/change": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Change Password
         * @description Change your password; your other browsers are signed out.
         */
        post: operations["change_password"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/password/reauthenticate": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Reauthenticate By Password
         * @description Enter your password again, for operations that require a recent sign-in.
         */
        post: operations["reauthenticate_by_password"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/providers/{name}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Begin Provider Sign In
         * @description Start to sign in with a provider: the browser goes to the returned URL.
         */
        post: operations["begin_provider_sign_in"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/providers/{name}/link": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Link Provider
         * @description Start to link an identity of a provider to your account.
         */
        post: operations["link_provider"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/providers/{name}/reauthenticate": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Begin Provider Reauthentication
         * @description Start to reauthenticate with a provider, which is asked to require the password.
         */
        post: operations["begin_provider_reauthentication"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/reset": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Reset Password
         * @description Choose a new password with an admin's link; your browsers are signed out and your personal tokens revoked.
         *
         *     Tokens of robots and runners stay valid.
         */
        post: operations["reset_password"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/auth/sign-out": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Sign Out
         * @description Sign this browser out.
         */
        post: operations["sign_out"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/events": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Watch Events
         * @description Stream the changes of everything you can see; a `refetch` event means that some may have been missed.
         *
         *     `change` names an object and where it is, never its content. A comment is sent every 15 s. When the stream ends,
         *     reconnect with the id of the last event to continue. It ends within seconds of your session, token or account.
         */
        get: operations["watch_events"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Files
         * @description List the files that match.
         */
        get: operations["list_files"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files/{file_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get File
         * @description Return one file.
         */
        get: operations["get_file"];
        put?: never;
        post?: never;
        /**
         * Delete File
         * @description Move a file to the trash.
         */
        delete: operations["delete_file"];
        options?: never;
        head?: never;
        /**
         * Update File
         * @description Rename, move or label a file; omitted fields do not change.
         */
        patch: operations["update_file"];
        trace?: never;
    };
    "/api/v1/files/{file_id}/lineage": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Lineage
         * @description Get the run that produced a file and the runs that read it.
         */
        get: operations["get_lineage"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files/{file_id}/preview": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Recording Preview
         * @description Return the preview of a recording, with a URL from which to read it; the audit log records who requests it.
         */
        get: operations["get_recording_preview"];
        put?: never;
        /**
         * Make Recording Preview
         * @description Make the preview of a recording again soon, also if it was deleted, or if the recording is small.
         */
        post: operations["make_recording_preview"];
        /**
         * Delete Recording Preview
         * @description Delete the preview of a recording, which all files with the same bytes share.
         */
        delete: operations["delete_recording_preview"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files/{file_id}/slice.mcap": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Slice File
         * @description Return some topics and a time range of a recording as a new MCAP, made while it is sent.
         *
         *     It has the bytes that `klein cut` makes. If it cannot be finished, the connection breaks; what was received by then
         *     has no footer and is no whole MCAP.
         */
        get: operations["slice_file"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files/{file_id}/topics": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List File Topics
         * @description List the topics of one file, by name.
         */
        get: operations["list_file_topics"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files/{file_id}/verify": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Verify File
         * @description Verify the stored bytes again: the server reads all of them; `state` and `verified_at` change when it has.
         */
        post: operations["verify_file"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files/download": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Download Files
         * @description Return URLs from which to read the content of files; the audit log records who requests them, and why.
         */
        post: operations["download_files"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files/labels": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Label Files
         * @description Add labels to many files and remove labels from them; the response has the outcome for each file.
         */
        post: operations["label_files"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/files/thumbnails": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Get File Thumbnails
         * @description Return a picture of a camera of each recording that has one, for lists; the audit log records who views them.
         */
        post: operations["get_file_thumbnails"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/findings": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Findings
         * @description List findings: those of the latest run first, in the order of its report.
         */
        get: operations["list_findings"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/groups": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Groups
         * @description List your groups by name; admins see all.
         */
        get: operations["list_groups"];
        put?: never;
        /**
         * Create Group
         * @description Create a group; you become its first member and editor.
         */
        post: operations["create_group"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/groups/{group_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Group
         * @description Return one group.
         */
        get: operations["get_group"];
        put?: never;
        post?: never;
        /**
         * Delete Group
         * @description Delete a group and the grants to it.
         */
        delete: operations["delete_group"];
        options?: never;
        head?: never;
        /**
         * Update Group
         * @description Rename a group; with If-Match, only if it still has that ETag.
         */
        patch: operations["update_group"];
        trace?: never;
    };
    "/api/v1/groups/{group_id}/members": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Group Members
         * @description List the members of a group by name; addresses and past members are for its editors.
         */
        get: operations["list_group_members"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/groups/{group_id}/members/{person_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        /**
         * Set Group Member
         * @description Add a person to a group, or change their membership; with If-Match, only if it still has that ETag.
         */
        put: operations["set_group_member"];
        post?: never;
        /**
         * Remove Group Member
         * @description Remove a person from a group, or leave it.
         */
        delete: operations["remove_group_member"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/home": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Home
         * @description Return recent missions, your unfinished uploads, and what needs attention.
         */
        get: operations["get_home"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/home/storage": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Home Storage
         * @description Return the size of the largest projects and, for admins, of the store.
         */
        get: operations["get_home_storage"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/library": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Library
         * @description List the actions that are shipped with this server, and which of them a project, or the whole lab, has.
         */
        get: operations["list_library"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/library/{name}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Add From Library
         * @description Publish a shipped action under its name, locked like others; where it was added before, its next version.
         *
         *     It is unchanged where nothing newer is shipped.
         */
        post: operations["add_from_library"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Me
         * @description Return who you are, and your credential.
         */
        get: operations["get_me"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me/account": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Account
         * @description Return your account: name, addresses, affiliations, and whether it has a password.
         */
        get: operations["get_account"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me/identities": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Identities
         * @description List the identities that are linked to your account.
         */
        get: operations["list_identities"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me/identities/{identity_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Unlink Identity
         * @description Unlink an identity from your account, unless it is your last sign-in method. Sessions and tokens stay valid.
         */
        delete: operations["unlink_identity"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me/sessions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Sessions
         * @description List the browsers you are signed in with, latest first.
         */
        get: operations["list_sessions"];
        put?: never;
        post?: never;
        /**
         * End All Sessions
         * @description Sign all your browsers out, including this one. Tokens stay valid.
         */
        delete: operations["end_all_sessions"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me/sessions/{session_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * End Session
         * @description Sign one of your browsers out.
         */
        delete: operations["end_session"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me/totp": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Begin Totp
         * @description Create a secret for an authenticator app; it takes effect once one of its codes is confirmed.
         */
        post: operations["begin_totp"];
        /**
         * Disable Totp
         * @description Remove your second factor.
         */
        delete: operations["disable_totp"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me/totp/confirm": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Confirm Totp
         * @description Confirm your second factor; your other browsers are signed out. The recovery codes are shown only once.
         */
        post: operations["confirm_totp"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/me/totp/recovery-codes": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Renew Recovery Codes
         * @description Replace your recovery codes.
         */
        post: operations["renew_recovery_codes"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/metrics": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Metrics
         * @description List the names of the metrics that runs reported.
         */
        get: operations["list_metrics"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/metrics/table": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Metric Table
         * @description Get a table of one metric: missions, or groups of them, by version, parameter, label or topic.
         */
        get: operations["get_metric_table"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/mission-events": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Mission Events
         * @description List the events of missions that match.
         */
        get: operations["list_mission_events"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/mission-events/{event_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Mission Event
         * @description Return one event.
         */
        get: operations["get_mission_event"];
        put?: never;
        post?: never;
        /**
         * Delete Mission Event
         * @description Delete an event.
         */
        delete: operations["delete_mission_event"];
        options?: never;
        head?: never;
        /**
         * Update Mission Event
         * @description Change an event; omitted fields do not change.
         */
        patch: operations["update_mission_event"];
        trace?: never;
    };
    "/api/v1/mission-positions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Mission Positions
         * @description Return where the latest missions that match were recorded: their first positions.
         */
        get: operations["list_mission_positions"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Missions
         * @description List the missions that match.
         */
        get: operations["list_missions"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Mission
         * @description Return one mission.
         */
        get: operations["get_mission"];
        put?: never;
        post?: never;
        /**
         * Delete Mission
         * @description Move a mission and its files to the trash.
         */
        delete: operations["delete_mission"];
        options?: never;
        head?: never;
        /**
         * Update Mission
         * @description Rename, move, complete or describe a mission; omitted fields do not change.
         */
        patch: operations["update_mission"];
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/access": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Mission Access
         * @description List who has a right on a mission now, by grants on it or its project; without WRITE, only your own access.
         */
        get: operations["get_mission_access"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/check-acceptances": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Accept Check
         * @description Accept that a check fails, until the mission's files change.
         */
        post: operations["accept_check"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/check-acceptances/{acceptance_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Withdraw Acceptance
         * @description Withdraw an acceptance: the check counts again.
         */
        delete: operations["withdraw_acceptance"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/check-notes": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Check Note
         * @description Add a note to a check of a mission.
         */
        post: operations["create_check_note"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/check-notes/{note_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Delete Check Note
         * @description Delete a note.
         */
        delete: operations["delete_check_note"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/check-reports": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Check Report
         * @description Store the checks that an uploader made of a mission's files.
         */
        post: operations["create_check_report"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/checks": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Mission Checks
         * @description Return a page of the checks of a mission and its verdict; with `all`, also what no longer counts.
         */
        get: operations["get_mission_checks"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/events": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Mission Event
         * @description Add an event to a mission; the event of this id or finding that it has is returned unchanged.
         */
        post: operations["create_mission_event"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/grants": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Mission Grants
         * @description List the grants on a mission itself.
         */
        get: operations["list_mission_grants"];
        put?: never;
        /**
         * Create Mission Grant
         * @description Grant a right on one mission; of the project, it shows only the name.
         */
        post: operations["create_mission_grant"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/grants/{grant_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Delete Mission Grant
         * @description Revoke a right on a mission.
         */
        delete: operations["delete_mission_grant"];
        options?: never;
        head?: never;
        /**
         * Update Mission Grant
         * @description Change the right or the end of a grant on a mission; omitted fields stay.
         */
        patch: operations["update_mission_grant"];
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/previews": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Mission Previews
         * @description List the pictures, tables and tracks that the latest run of each action shows of a mission.
         */
        get: operations["list_mission_previews"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/recordings": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Recordings
         * @description List the recordings of a mission, by name.
         */
        get: operations["list_recordings"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/shares": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Share
         * @description Create a link to a mission or some of its files; its secret is shown only once, in this response.
         */
        post: operations["create_share"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/timeline": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Mission Timeline
         * @description Return start and end of each file of a mission, by path.
         */
        get: operations["get_mission_timeline"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/topics": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Mission Topics
         * @description List the topics of a mission by name and type, with message counts in at most `bins` bins.
         */
        get: operations["list_mission_topics"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/{mission_id}/uploads": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Open
         * @description List your open uploads into a mission.
         */
        get: operations["list_uploads"];
        put?: never;
        /**
         * Begin
         * @description Announce files to upload and learn what to send.
         */
        post: operations["begin_uploads"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/missions/pictures": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Get Mission Pictures
         * @description Return the first picture of each of some missions, for lists; the audit log records who views them.
         */
        post: operations["get_mission_pictures"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/overview": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Overview
         * @description Return statistics of all visible missions, or of those of one project, by `month` or by a metadata field.
         */
        get: operations["get_overview"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List People
         * @description List the people who share a group or a project with you; admins see all.
         */
        get: operations["list_people"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Person
         * @description Return one person.
         */
        get: operations["get_person"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}/admin": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Make Admin
         * @description Make a person a permanent admin.
         */
        post: operations["make_admin"];
        /**
         * Unmake Admin
         * @description Remove a person from the admins, unless they are the last permanent one.
         */
        delete: operations["unmake_admin"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}/deactivate": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Deactivate Person
         * @description Deactivate a person: their sessions, tokens and links end; projects that only they owned go to the admins.
         */
        post: operations["deactivate_person"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}/erase": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Erase Person
         * @description Erase a person irrevocably: their data is deleted, and a pseudonym replaces their name. The second time, report.
         *
         *     What they did stays on record. Texts that mention them are reported, and stay as they are.
         */
        post: operations["erase_person"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}/erasure": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Erasure
         * @description Return whether the audit log of an erased person is redacted.
         */
        get: operations["get_erasure"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}/export": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Export Person
         * @description Return all that is kept of a person, one JSON object a line: for yourself, or as an admin for anybody.
         */
        get: operations["export_person"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}/reactivate": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Reactivate Person
         * @description Let a deactivated person sign in again; their tokens stay revoked.
         */
        post: operations["reactivate_person"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}/reset": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Reset Link
         * @description Create a password reset link, which you pass on to the person.
         */
        post: operations["create_reset_link"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/{person_id}/totp": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Reset Totp
         * @description Remove the second factor of a person who lost their device and recovery codes.
         */
        delete: operations["reset_totp"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/people/invitations": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Invite Person
         * @description Create an invitation link, which you pass on to the person.
         */
        post: operations["invite_person"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Projects
         * @description List the projects that match.
         */
        get: operations["list_projects"];
        put?: never;
        /**
         * Create Project
         * @description Create a project.
         */
        post: operations["create_project"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Project
         * @description Return one project.
         */
        get: operations["get_project"];
        put?: never;
        post?: never;
        /**
         * Delete Project
         * @description Move a project and everything in it to the trash.
         */
        delete: operations["delete_project"];
        options?: never;
        head?: never;
        /**
         * Update Project
         * @description Rename or describe a project, or change its metadata fields; omitted fields stay.
         */
        patch: operations["update_project"];
        trace?: never;
    };
    "/api/v1/projects/{project_id}/access": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Project Access
         * @description List who has a right on a project now, and why; without WRITE there, only your own access.
         */
        get: operations["get_project_access"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/actions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Project Actions
         * @description List the actions that a project names: they run by themselves, and count for its verdicts.
         */
        get: operations["list_project_actions"];
        put?: never;
        /**
         * Add Project Action
         * @description Have an action run by itself on the missions of a project that are due from now on.
         */
        post: operations["add_project_action"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/actions/{action_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Remove Project Action
         * @description Stop an action from running by itself; its runs stay.
         */
        delete: operations["remove_project_action"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/checks": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Project Checks
         * @description Return the `checks.yaml` of a project.
         */
        get: operations["get_project_checks"];
        /**
         * Set Project Checks
         * @description Set the `checks.yaml` of a project and judge its missions by it; an empty text removes it.
         */
        put: operations["set_project_checks"];
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/checks/matrix": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Check Matrix
         * @description Return a page of a project's missions, latest first, with the worst status of each check.
         */
        get: operations["get_check_matrix"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/checks/trend": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Check Trend
         * @description Return the verdicts of a project's missions by the day or week of their recordings.
         */
        get: operations["get_check_trend"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/checks/versions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Checks Versions
         * @description List the versions of a project's `checks.yaml`, latest first.
         */
        get: operations["list_checks_versions"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/checks/versions/{number}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Checks Version
         * @description Return one version of a project's `checks.yaml`.
         */
        get: operations["get_checks_version"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/grants": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Project Grants
         * @description List the grants on a project, including expired ones, by the name of the grantee.
         */
        get: operations["list_project_grants"];
        put?: never;
        /**
         * Create Project Grant
         * @description Grant a right on a project and all its missions; it replaces the grantee's earlier one.
         */
        post: operations["create_project_grant"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/grants/{grant_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Delete Project Grant
         * @description Revoke a right on a project.
         */
        delete: operations["delete_project_grant"];
        options?: never;
        head?: never;
        /**
         * Update Project Grant
         * @description Change the right or the end of a grant on a project; omitted fields stay.
         */
        patch: operations["update_project_grant"];
        trace?: never;
    };
    "/api/v1/projects/{project_id}/missions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Mission
         * @description Create a mission; its metadata must satisfy the project's fields.
         */
        post: operations["create_mission"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/stats": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Project Stats
         * @description Return hours, bytes and files of a project, by `month` or by the values of a metadata field.
         */
        get: operations["get_project_stats"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/template": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Mission Template
         * @description Return the form for the project's next mission, also as YAML.
         */
        get: operations["get_mission_template"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/viewer-layouts": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Viewer Layouts
         * @description List the shared layouts of a project, and the caller's own, by name.
         */
        get: operations["list_viewer_layouts"];
        put?: never;
        /**
         * Create Viewer Layout
         * @description Add a layout to a project.
         */
        post: operations["create_viewer_layout"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/projects/{project_id}/viewer-layouts/{layout_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Delete Viewer Layout
         * @description Delete a layout.
         */
        delete: operations["delete_viewer_layout"];
        options?: never;
        head?: never;
        /**
         * Update Viewer Layout
         * @description Change a layout; omitted fields do not change.
         */
        patch: operations["update_viewer_layout"];
        trace?: never;
    };
    "/api/v1/recordings/{recording_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Recording
         * @description Return one recording.
         */
        get: operations["get_recording"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/run-checks": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Run Checks
         * @description List the checks that runs reported: those of the latest run first, in the order of its report.
         */
        get: operations["list_run_checks"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/run-metrics": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Run Metrics
         * @description List metrics: those of the latest run first, in the order of its report.
         */
        get: operations["list_run_metrics"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runner/runs/{run_id}/context": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Run Context
         * @description Get the content of `/in/mission.json`.
         */
        get: operations["get_run_context"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runner/runs/{run_id}/finish": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Finish Run
         * @description Report the end of a run, once its artifacts are uploaded.
         */
        post: operations["finish_run"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runner/runs/{run_id}/inputs": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Sign Inputs
         * @description Get URLs of inputs.
         */
        post: operations["sign_inputs"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runner/runs/{run_id}/log-chunks": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Log Chunk
         * @description Get a URL to upload a chunk of the log to.
         */
        post: operations["create_log_chunk"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runner/runs/{run_id}/log-chunks/confirm": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Confirm Log Chunk
         * @description Confirm that a chunk of the log was uploaded; it becomes visible.
         */
        post: operations["confirm_log_chunk"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runner/runs/{run_id}/uploads": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Create Artifact Uploads
         * @description Start uploads of artifacts, by the same protocol as files of a mission.
         */
        post: operations["create_artifact_uploads"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runners": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Runners
         * @description List runners by name.
         */
        get: operations["list_runners"];
        put?: never;
        /**
         * Register Runner
         * @description Register a runner, or update its description.
         */
        post: operations["register_runner"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runners/{runner_id}/claims": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Claim Run
         * @description Claim a run that fits the free resources; wait for one.
         */
        post: operations["claim_run"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runners/{runner_id}/contexts": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Get Run Contexts
         * @description Get the contents of `/in/mission.json` of several runs.
         */
        post: operations["get_run_contexts"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runners/{runner_id}/ends": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Finish Runs
         * @description Report the ends of several runs, once their artifacts are uploaded.
         */
        post: operations["finish_runs"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runners/{runner_id}/heartbeats": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Send Heartbeats
         * @description Report the states of all runs, and renew their leases.
         */
        post: operations["send_heartbeats"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Runs
         * @description List runs, latest first.
         */
        get: operations["list_runs"];
        put?: never;
        /**
         * Create Runs
         * @description Run an action on each of some missions, with an outcome for each.
         */
        post: operations["create_runs"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs/{run_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Run
         * @description Get a run with its details.
         */
        get: operations["get_run"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs/{run_id}/artifacts": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Artifacts
         * @description List the artifacts of a run by path.
         */
        get: operations["list_artifacts"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs/{run_id}/artifacts/download": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Download Artifacts
         * @description Return URLs of artifacts; the audit log records who requests them, and why.
         */
        post: operations["download_artifacts"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs/{run_id}/cancel": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Cancel Run
         * @description Cancel a run; a running one ends within seconds.
         */
        post: operations["cancel_run"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs/{run_id}/inputs": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Run Inputs
         * @description List the inputs of a run by path.
         */
        get: operations["list_run_inputs"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs/{run_id}/log": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Run Log
         * @description Get a chunk of the log of a run. The next one starts at `next_offset`, until `is_over`.
         */
        get: operations["get_run_log"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs/{run_id}/retry": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Retry Run
         * @description Launch the same action again, on the current files; with `force`, without reusing results.
         */
        post: operations["retry_run"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/runs/recorded": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Record Run
         * @description Record a run that was executed elsewhere, with its results; recording the same again changes nothing.
         */
        post: operations["record_run"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/search": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Search
         * @description Return the first missions, files and topics that a query finds, and the number of each.
         */
        get: operations["search"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/search/facets": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Facets
         * @description Return the facets of the files that a query finds, and the query with each value selected.
         */
        get: operations["get_facets"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/service": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Service
         * @description Return what this server is, and who you are.
         */
        get: operations["get_service"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/share": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Shared
         * @description Return what the link of this request shows.
         */
        get: operations["get_share"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/shares": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Shares
         * @description List the links that you may revoke, latest first; with `ended`, also revoked and expired ones.
         */
        get: operations["list_shares"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/shares/{share_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Revoke Share
         * @description Revoke a link, from the next request on.
         */
        delete: operations["revoke_share"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/stats": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get Stats
         * @description Return hours, bytes, files and messages of the files that match.
         */
        get: operations["get_stats"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/tokens": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Tokens
         * @description List tokens, latest first; with `ended`, also revoked and expired ones.
         */
        get: operations["list_tokens"];
        put?: never;
        /**
         * Create Token
         * @description Create a token; its secret is shown only once, in this response.
         */
        post: operations["create_token"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/tokens/{token_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Revoke Token
         * @description Revoke a token and all that were created with it, from the next request on; with `made=valid`, only itself.
         */
        delete: operations["revoke_token"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/topics": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Topics
         * @description List the topics of the files that match, by name.
         */
        get: operations["list_topics"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/trash": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * List Trash
         * @description List what was deleted and can still be restored, latest first.
         */
        get: operations["list_trash"];
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/trash/{resource_type}/{resource_id}/restore": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Restore From Trash
         * @description Restore a deleted project, mission or file.
         */
        post: operations["restore_from_trash"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/uploads/{upload_id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Get
         * @description Get one of your uploads, with the parts that the store has.
         */
        get: operations["get_upload"];
        put?: never;
        post?: never;
        /**
         * Abort
         * @description Abort an upload.
         */
        delete: operations["abort_upload"];
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/uploads/complete": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Complete
         * @description Finish uploads whose parts are all sent.
         */
        post: operations["complete_uploads"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/uploads/parts": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Sign
         * @description Get the URLs to send parts to; this also renews the leases of their uploads.
         */
        post: operations["sign_parts"];
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
}
export type webhooks = Record<string, never>;
export interface components {
    schemas: {
        /**
         * AcceptanceEnd
         * @description Why an acceptance ended: a person withdrew it or accepted the check again, or the files changed.
         * @enum {string}
         */
        AcceptanceEnd: "withdrawn" | "replaced" | "files_changed";
        /**
         * AccessRead
         * @description A right that somebody has now, and its source; of several, the highest counts.
         *
         *     `to` is the grantee; null for all admins or, in a public project, everybody. `person` has the right through it;
         *     null if unknown or hidden, such as members of a group or the owner of an address. `expires_at` is when the grant or
         *     the membership ends, whichever is first.
         */
        AccessRead: {
            /** Expires At */
            expires_at: string | null;
            /** Grant Id */
            grant_id: string | null;
            person: components["schemas"]["PersonRef"] | null;
            right: components["schemas"]["Right"];
            through: components["schemas"]["AccessThrough"];
            to: components["schemas"]["Grantee"] | null;
        };
        /**
         * AccessThrough
         * @description The source of a right: a grant on the project or mission, a public project, or admin rights.
         * @enum {string}
         */
        AccessThrough: "project grant" | "mission grant" | "public" | "admin";
        /**
         * AccountRead
         * @description Your account: `GET /me/account`. `affiliations` are the groups that follow from your addresses.
         *
         *     `totp` is the confirmed second factor. `has_password`: you can sign in with a password.
         */
        AccountRead: {
            /** Addresses */
            addresses: components["schemas"]["AddressRead"][];
            /** Affiliations */
            affiliations: string[];
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Has Password */
            has_password: boolean;
            person: components["schemas"]["PersonRef"];
            totp?: components["schemas"]["TotpRead"] | null;
        };
        /**
         * ActionCreate
         * @description An action to publish: in a project, or without one for the whole lab.
         */
        ActionCreate: {
            definition: components["schemas"]["ActionDefinition"];
            /** Project Id */
            project_id?: string | null;
        };
        /**
         * ActionDefinition
         * @description One version of an action: either an `image` with its `command`, or a `script` on the default image.
         *
         *     `command` is an argument list; empty: the image's own command. A script is started with Python, and its
         *     `dependencies` (PEP 508) are installed for it in the versions of its `lock` (pip requirements with hashes), which
         *     the server makes where it is null. Without a lock, they must be installed in the image. `requires_python` (`>=3.11`)
         *     is the Python that the script needs.
         *     `right` is the right on the mission that launching requires, and the right of the run's token.
         *     `metrics` describes metrics for tables; an action may report others, too.
         *     `library` is set by the server where it added a shipped action; it is ignored in what people publish or run.
         */
        ActionDefinition: {
            /**
             * @default {
             *       "exclusive": false,
             *       "options": {}
             *     }
             */
            cluster: components["schemas"]["ClusterRequest"];
            /**
             * Command
             * @default []
             */
            command: string[];
            /**
             * Dependencies
             * @default []
             */
            dependencies: string[];
            /**
             * Description
             * @default
             */
            description: string;
            /** Image */
            image?: string | null;
            /**
             * @default {
             *       "checks": false,
             *       "derived": false,
             *       "message_types": [],
             *       "metadata": [],
             *       "paths": [],
             *       "reference": false,
             *       "topics": []
             *     }
             */
            inputs: components["schemas"]["Inputs"];
            /** Library */
            library?: string | null;
            /** Lock */
            lock?: string | null;
            /**
             * Metrics
             * @default []
             */
            metrics: components["schemas"]["DeclaredMetric"][];
            /** Name */
            name: string;
            /** @default none */
            network: components["schemas"]["Network"];
            /**
             * Parameters
             * @default []
             */
            parameters: components["schemas"]["Parameter"][];
            /** Requires Python */
            requires_python?: string | null;
            /**
             * @default {
             *       "cores": 1,
             *       "disk_bytes": 10000000000,
             *       "gpus": 0,
             *       "labels": [],
             *       "memory_bytes": 2000000000,
             *       "time_s": 3600
             *     }
             */
            resources: components["schemas"]["Resources"];
            /** @default READ */
            right: components["schemas"]["Right"];
            /** Script */
            script?: string | null;
        };
        /**
         * ActionRead
         * @description An action with its latest version. `project` is null for the whole lab; `may_change`: the caller may change it.
         *
         *     `etag` covers the latest version and `archived`: a change or a further version with an outdated one is refused.
         */
        ActionRead: {
            /** Archived */
            archived: boolean;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"];
            /** Description */
            description: string;
            /** Etag */
            etag?: string;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            latest: components["schemas"]["ActionVersionRead"];
            /** May Change */
            may_change: boolean;
            /** Name */
            name: string;
            project: components["schemas"]["ProjectRef"] | null;
        };
        /**
         * ActionRef
         * @description A version of an action; id and version are null where the action is not published.
         */
        ActionRef: {
            /** Id */
            id?: string | null;
            /** Name */
            name: string;
            /** Version */
            version: number | null;
        };
        /**
         * ActionUpdate
         * @description A change of an action. An archived action is not listed and starts no runs; its runs stay.
         */
        ActionUpdate: {
            /** Archived */
            archived: boolean;
        };
        /**
         * ActionVersionRead
         * @description One version of an action, which never changes.
         *
         *     `image_digest` is what the image's name was first resolved to (`sha256:…`), from then on used by every run; null
         *     before, and for a script on the default image. `packages` are the versions in its lock, such as
         *     `evo==1.38.1`; lists leave the lock itself out, since it is large.
         */
        ActionVersionRead: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"];
            definition: components["schemas"]["ActionDefinition"];
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Image Digest */
            image_digest: string | null;
            /** Number */
            number: number;
            /**
             * Packages
             * @default []
             */
            packages: string[];
        };
        /**
         * AddressRead
         * @description A verified address; `verified_by` is the URL of a provider, or how the account was created.
         */
        AddressRead: {
            /** Email */
            email: string;
            /**
             * Verified At
             * Format: date-time
             */
            verified_at: string;
            /** Verified By */
            verified_by: string;
        };
        /**
         * AdminBootstrap
         * @description Become the first admin of a new server: `POST /auth/bootstrap`. Signed-in people send only the code.
         */
        AdminBootstrap: {
            /** Code */
            code: string;
            /** Email */
            email?: string | null;
            /** Name */
            name?: string | null;
            /** Password */
            password?: string | null;
        };
        /**
         * AdminHealth
         * @description The state of the server.
         *
         *     `not_ready`: why it cannot serve. `workers_at`: last heartbeat of each living worker; `worker_last_at`: of any.
         *     `runs_problem`: why runs cannot start, and what to do; null if they can, or if no runner was ever started.
         *     `invitation_warning`: what stops once a second person has an account, and what to do before.
         */
        AdminHealth: {
            /** Clock Skew S */
            clock_skew_s: number;
            /** Database Bytes */
            database_bytes: number;
            /** Database Version */
            database_version: string;
            /** Invitation Warning */
            invitation_warning: string | null;
            /** Not Ready */
            not_ready: string | null;
            /**
             * Now
             * Format: date-time
             */
            now: string;
            /** Runs Problem */
            runs_problem: string | null;
            /** Schema Version */
            schema_version: string;
            /** Store Allows Browser Uploads */
            store_allows_browser_uploads: boolean;
            /** Store Checksum */
            store_checksum: string;
            /** Store Refuses Overwrites */
            store_refuses_overwrites: boolean;
            /** Version */
            version: string;
            /** Warnings */
            warnings: string[];
            /** Worker Last At */
            worker_last_at: string | null;
            /** Workers At */
            workers_at: string[];
        };
        /**
         * AdminJobs
         * @description The queue, the jobs that wait for another attempt, and the last failed ones, at most 100 of each.
         *
         *     Failed jobs are deleted after a week.
         */
        AdminJobs: {
            /** Failed */
            failed: components["schemas"]["FailedJob"][];
            /** Queue */
            queue: components["schemas"]["JobAmount"][];
            /** Retrying */
            retrying: components["schemas"]["RetryingJob"][];
        };
        /**
         * AdminSettings
         * @description The settings of the process that answered, by name.
         */
        AdminSettings: {
            /** Settings */
            settings: components["schemas"]["SettingRead"][];
        };
        /**
         * AdminStatus
         * @description Whether the server is healthy, what is full and when, and what needs an admin; problems come first.
         *
         *     `capacities` are in the order in which they will be full. The store is one of them if its size is known:
         *     KLEINKRAM_STORE_FOLDER or KLEINKRAM_STORE_CAPACITY_BYTES.
         */
        AdminStatus: {
            /** Capacities */
            capacities: components["schemas"]["CapacityForecast"][];
            /** Is Healthy */
            is_healthy: boolean;
            /** Items */
            items: components["schemas"]["StatusItem"][];
            /**
             * Now
             * Format: date-time
             */
            now: string;
            /** Stored Bytes */
            stored_bytes: number;
            /** Stored Bytes Per Day */
            stored_bytes_per_day: number;
            /** Version */
            version: string;
        };
        /**
         * AdminStorage
         * @description Stored blobs by state, those that only the trash uses, uploads in progress, and what is about to be deleted.
         *
         *     A blob counts once, however many files have it.
         */
        AdminStorage: {
            /** Blobs */
            blobs: components["schemas"]["StateAmount"][];
            /** Is Low */
            is_low: boolean;
            marked_for_deletion: components["schemas"]["StateAmount"];
            store: components["schemas"]["StoreUse"];
            trash: components["schemas"]["StateAmount"];
            uploads: components["schemas"]["StateAmount"];
        };
        /**
         * Aggregate
         * @description How several values of a cell become one number. `latest` is that of the latest run, `count` their number.
         * @enum {string}
         */
        Aggregate: "median" | "mean" | "min" | "max" | "latest" | "count";
        /**
         * AlreadyPresent
         * @description The mission already has this file. Send nothing. `file` is null without the right to read.
         */
        AlreadyPresent: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            decision: "already_present";
            file: components["schemas"]["FileRead"] | null;
        };
        /**
         * ArtifactRead
         * @description A file that a run produced. `file_id` is the file of the mission that was created from it, if any.
         */
        ArtifactRead: {
            /** File Id */
            file_id: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Path */
            path: string;
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
            /** Sha256 */
            sha256: string;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * ArtifactsRequest
         * @description Artifacts of a run to download or preview; the audit log contains the purpose.
         */
        ArtifactsRequest: {
            /** Artifact Ids */
            artifact_ids: string[];
            /** @default download */
            purpose: components["schemas"]["FetchPurpose"];
        };
        /**
         * ArtifactUploadsCreate
         * @description Artifacts to upload, and the complete log as `LOG_PATH`, by the same protocol as files of a mission.
         */
        ArtifactUploadsCreate: {
            /** Attempt */
            attempt: number;
            /** Files */
            files: components["schemas"]["UploadFile"][];
        };
        /**
         * ArtifactUrl
         * @description A URL to GET an artifact from before `expires_at`.
         */
        ArtifactUrl: {
            artifact: components["schemas"]["ArtifactRead"];
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /** Url */
            url: string;
        };
        /**
         * ArtifactUrls
         * @description URLs of artifacts, in the requested order.
         */
        ArtifactUrls: {
            /** Items */
            items: components["schemas"]["ArtifactUrl"][];
        };
        /**
         * AssignedInput
         * @description An input file of a run.
         */
        AssignedInput: {
            /** Path */
            path: string;
            /** Sha256 */
            sha256: string;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * Attention
         * @description A number of objects that need attention, in one mission or on the whole server.
         */
        Attention: {
            /** Count */
            count: number;
            kind: components["schemas"]["AttentionKind"];
            mission?: components["schemas"]["MissionRef"] | null;
        };
        /**
         * AttentionKind
         * @description Reasons for attention. The last four concern the whole server and are shown to admins.
         * @enum {string}
         */
        AttentionKind: "files_corrupt" | "files_lost" | "files_broken" | "files_unread" | "files_recovered" | "runs_cannot_start" | "runs_failed" | "metadata_missing" | "scrub_stopped" | "verifications_overdue" | "jobs_failed" | "disk_low";
        /**
         * AuditRead
         * @description One event: who did what to which object, and what changed.
         *
         *     Only the person and admins see their `address` and `session_id`; owners see those of links and guests.
         *     `as_admin`: it required admin rights; the actor's own rights would not have sufficed.
         */
        AuditRead: {
            actor: components["schemas"]["PersonRef"] | null;
            /** Address */
            address: string | null;
            /** After */
            after: {
                [key: string]: components["schemas"]["JsonValue"];
            };
            /** As Admin */
            as_admin: boolean;
            /**
             * At
             * Format: date-time
             */
            at: string;
            /** Before */
            before: {
                [key: string]: components["schemas"]["JsonValue"];
            };
            /** Id */
            id: number;
            /** Mission Id */
            mission_id: string | null;
            /** Operation */
            operation: string;
            /** Project Id */
            project_id: string | null;
            /** Request Id */
            request_id: string | null;
            /** Resource Id */
            resource_id: string | null;
            /** Resource Name */
            resource_name: string;
            /** Resource Type */
            resource_type: string;
            /** Session Id */
            session_id: string | null;
            share: components["schemas"]["CredentialRef"] | null;
            token: components["schemas"]["CredentialRef"] | null;
        };
        /**
         * Better
         * @description Which values of a metric are better; `none`: neither, as of a count.
         * @enum {string}
         */
        Better: "lower" | "higher" | "none";
        /**
         * BlobState
         * @description State of a file's bytes: received by the store, read and verified by the server, missing, or altered.
         * @enum {string}
         */
        BlobState: "stored" | "verified" | "lost" | "corrupt";
        /**
         * BrowserSignedIn
         * @description The signed-in person; the session is in a cookie that no script can read.
         */
        BrowserSignedIn: {
            person: components["schemas"]["PersonRef"];
        };
        /**
         * Bucket
         * @description Files of one month, of one value of a field, or of numbers from `low` (inclusive) to `high` (exclusive).
         *
         *     All three are null for files without such a time or value.
         */
        Bucket: {
            /** High */
            high?: number | null;
            /** Low */
            low?: number | null;
            stats: components["schemas"]["StatsRow"];
            /** Value */
            value: string | null;
        };
        /**
         * Capacity
         * @description Resources of a machine for runs: all of them, or those that are free.
         */
        Capacity: {
            /** Cores */
            cores: number;
            /** Disk Bytes */
            disk_bytes: number;
            /** Gpus */
            gpus: number;
            /** Memory Bytes */
            memory_bytes: number;
        };
        /**
         * CapacityForecast
         * @description A limit, and when it will be reached: the quota of a project, or the store's disk (`project` is null).
         *
         *     `per_day` is the mean of the last 30 days, or of the project's or server's life if that is shorter: what was added
         *     and still exists. `full_at`: null if nothing is added, or for more than ten years.
         */
        CapacityForecast: {
            /** Full At */
            full_at: string | null;
            /** Limit */
            limit: number;
            /** Per Day */
            per_day: number;
            project: components["schemas"]["ProjectRef"] | null;
            unit: components["schemas"]["CapacityUnit"];
            /** Used */
            used: number;
        };
        /**
         * CapacityUnit
         * @description What a limit counts.
         * @enum {string}
         */
        CapacityUnit: "bytes" | "files";
        /**
         * Cause
         * @description Who launched a run, and which run it retries.
         */
        Cause: {
            person?: components["schemas"]["PersonRef"] | null;
            /** Retry Of Id */
            retry_of_id?: string | null;
        };
        /**
         * CellStatus
         * @description The worst status of a check over its topics, worst first; `accepted`: people accepted all that failed.
         * @enum {string}
         */
        CellStatus: "error" | "warning" | "not_made" | "needs_content" | "accepted" | "ok";
        /**
         * Check
         * @description The outcome of one check.
         *
         *     `value` was measured and `limit` is the bound that it is compared with, both in `unit`. `topic`, `file` (or the
         *     name of a recording) and `time_ns` (log time, ns since 1970) say where; null where they do not apply.
         */
        Check: {
            /** File */
            file?: string | null;
            /** Limit */
            limit?: number | null;
            /** Message */
            message: string;
            /** Name */
            name: string;
            status: components["schemas"]["CheckStatus"];
            /** Time Ns */
            time_ns?: number | null;
            /** Topic */
            topic?: string | null;
            /** Unit */
            unit?: string | null;
            /** Value */
            value?: number | null;
        };
        /**
         * CheckAcceptanceCreate
         * @description Accept that a check of a mission fails as it does now. Without a topic, on all topics on which it fails now.
         */
        CheckAcceptanceCreate: {
            /** Because */
            because: string;
            /** Check */
            check: string;
            /** Topic */
            topic?: string | null;
        };
        /**
         * CheckAcceptanceRead
         * @description A person's decision that what failed of a check does not count, and nothing that fails later.
         *
         *     `failure_count` is how many failures it covers. `ended` is null while it applies. Without an account, `created_by`
         *     is not shown.
         */
        CheckAcceptanceRead: {
            /** Because */
            because: string;
            /** Check */
            check: string;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"] | null;
            ended: components["schemas"]["AcceptanceEnd"] | null;
            /** Ended At */
            ended_at: string | null;
            ended_by: components["schemas"]["PersonRef"] | null;
            /** Failure Count */
            failure_count: number;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Topic */
            topic: string | null;
        };
        /**
         * CheckCounts
         * @description The number of checks of a mission by status. Accepted ones are only in `accepted`.
         */
        CheckCounts: {
            /**
             * Accepted
             * @default 0
             */
            accepted: number;
            /**
             * Error
             * @default 0
             */
            error: number;
            /**
             * Needs Content
             * @default 0
             */
            needs_content: number;
            /**
             * Not Made
             * @default 0
             */
            not_made: number;
            /**
             * Ok
             * @default 0
             */
            ok: number;
            /**
             * Warning
             * @default 0
             */
            warning: number;
        };
        /**
         * CheckDepth
         * @description What was read for checks: only the indexes of recordings, or also the messages that samples need.
         * @enum {string}
         */
        CheckDepth: "index" | "content";
        /**
         * CheckMatrix
         * @description One page of a project's missions, latest first, and the names of all checks in it, by how often they fail.
         */
        CheckMatrix: {
            /** Checks */
            checks: string[];
            /** Items */
            items: components["schemas"]["CheckMatrixRow"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /**
         * CheckMatrixRow
         * @description One mission of the matrix: of each check that was made, the worst status over its topics.
         */
        CheckMatrixRow: {
            /** Cells */
            cells: {
                [key: string]: components["schemas"]["CellStatus"];
            };
            counts: components["schemas"]["CheckCounts"];
            mission: components["schemas"]["NamedRef"];
            /** Start Ns */
            start_ns: number | null;
            verdict: components["schemas"]["Verdict"];
        };
        /**
         * CheckNoteCreate
         * @description A note on a check of a mission; without a topic, on all topics.
         */
        CheckNoteCreate: {
            /** Check */
            check: string;
            /** Text */
            text: string;
            /** Topic */
            topic?: string | null;
        };
        /**
         * CheckNoteRead
         * @description A person's note on a check of a mission.
         */
        CheckNoteRead: {
            /** Check */
            check: string;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"];
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Text */
            text: string;
            /** Topic */
            topic: string | null;
        };
        /**
         * CheckRead
         * @description A check, and the run that reported it with its parameters.
         */
        CheckRead: {
            action: components["schemas"]["ActionRef"];
            check: components["schemas"]["Check"];
            /** Ended At */
            ended_at: string | null;
            /** Id */
            id: number;
            mission: components["schemas"]["MissionRef"];
            /** Parameters */
            parameters: {
                [key: string]: boolean | number | string;
            };
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
        };
        /**
         * CheckReportCreate
         * @description Checks by an uploader or a run, by profiles of the `checks.yaml` with this hash, of files (SHA-256 by path).
         *
         *     They count while exactly these are the recorded files of the mission, and exactly these profiles apply to it.
         */
        CheckReportCreate: {
            /** Checks */
            checks: components["schemas"]["Check"][];
            depth: components["schemas"]["CheckDepth"];
            /** Document Sha256 */
            document_sha256: string;
            /** Files */
            files: {
                [key: string]: string;
            };
            /** Profiles Applied */
            profiles_applied: string[];
        };
        /**
         * CheckReportRead
         * @description A report of checks by an uploader or a run, without the checks.
         *
         *     `is_current`: it was made of the present files and by the present `checks.yaml` (by any, while the project has
         *     none), so that it counts. `run_id`: the run that made it, which acted for `created_by`.
         */
        CheckReportRead: {
            /** Check Count */
            check_count: number;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"];
            depth: components["schemas"]["CheckDepth"];
            /** Document Sha256 */
            document_sha256: string;
            /** File Count */
            file_count: number;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Current */
            is_current: boolean;
            /** Run Id */
            run_id?: string | null;
            verdict: components["schemas"]["Verdict"];
        };
        /**
         * CheckSource
         * @description Who made a check: the server, from the index; the report of an uploader or run; or an action of the project.
         * @enum {string}
         */
        CheckSource: "server" | "report" | "action";
        /**
         * CheckStatus
         * @description Outcome of one check.
         *
         *     not_made: it could not be made, with the reason in its message; counts as a warning. needs_content: it reads the
         *     messages themselves, and only the index was read; while there is such a check, nothing is good.
         * @enum {string}
         */
        CheckStatus: "ok" | "warning" | "error" | "not_made" | "needs_content";
        /**
         * ChecksumKind
         * @description Method by which the store verifies received bytes, as probed when the server started.
         *
         *     `crc64nvme`: every part by a signed CRC-64/NVME header, and the whole object by the full-object CRC-64/NVME.
         *     `sha256`: every part by a signed SHA-256 header. `md5`: every part by a signed Content-MD5, for old stores.
         * @enum {string}
         */
        ChecksumKind: "crc64nvme" | "sha256" | "md5";
        /**
         * ChecksVersionRead
         * @description A version of a project's `checks.yaml`. `is_removal`: its text is empty.
         */
        ChecksVersionRead: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"];
            /** Is Removal */
            is_removal: boolean;
            /** Number */
            number: number;
            /** Sha256 */
            sha256: string;
        };
        /**
         * CheckTrend
         * @description The verdicts of a project's missions over time; days or weeks without missions are left out.
         */
        CheckTrend: {
            /** Buckets */
            buckets: components["schemas"]["TrendBucket"][];
            by: components["schemas"]["TrendStep"];
        };
        /**
         * ClaimReply
         * @description The answer to a claim; `run` is null where no run fits. `more` are those beyond the first.
         */
        ClaimReply: {
            /**
             * More
             * @default []
             */
            more: components["schemas"]["RunAssignment"][];
            run: components["schemas"]["RunAssignment"] | null;
        };
        /**
         * ClaimRequest
         * @description A runner's free resources, and how long to wait for a run. `active_run_ids`: the runs that it already has.
         *
         *     At most `max_runs` are assigned at once; each of them may need all of the free resources, so that a runner with room
         *     for one at a time asks for one.
         */
        ClaimRequest: {
            /**
             * Active Run Ids
             * @default []
             */
            active_run_ids: string[];
            free: components["schemas"]["Capacity"];
            /**
             * Max Runs
             * @default 1
             */
            max_runs: number;
            /**
             * Wait S
             * @default 0
             */
            wait_s: number;
        };
        /**
         * CliExchange
         * @description Exchange the code from the browser for a token: `POST /auth/cli/token`. A code is valid once.
         */
        CliExchange: {
            /** Code */
            code: string;
            /** Code Verifier */
            code_verifier: string;
        };
        /**
         * ClusterRequest
         * @description What a run needs of a cluster beyond its resources; a runner of one machine ignores it.
         *
         *     `constraint` names features of nodes, such as `a100|h100`. `exclusive`: nothing else runs on its node. `options` are
         *     further options of the cluster's submission, by their names without dashes, of those that its runner allows.
         */
        ClusterRequest: {
            /** Constraint */
            constraint?: string | null;
            /**
             * Exclusive
             * @default false
             */
            exclusive: boolean;
            /**
             * Options
             * @default {}
             */
            options: {
                [key: string]: string;
            };
        };
        /**
         * CodeRead
         * @description Purpose and recipient of a link: `POST /auth/codes`. The request does not use the link.
         */
        CodeRead: {
            /** Email */
            email: string | null;
            /** Name */
            name: string | null;
            /** Purpose */
            purpose: string;
        };
        /**
         * CodeSignIn
         * @description Sign in with a one-time link: `POST /auth/link`.
         */
        CodeSignIn: {
            /** Code */
            code: string;
        };
        /**
         * Completed
         * @description The upload is complete and the file exists. `file` is null without the right to read.
         */
        Completed: {
            file: components["schemas"]["FileRead"] | null;
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            outcome: "completed";
            /**
             * Upload Id
             * Format: uuid
             */
            upload_id: string;
        };
        /**
         * ContentState
         * @description What the server has read of a file's content (see the concepts page).
         * @enum {string}
         */
        ContentState: "pending" | "indexed" | "recovered" | "broken" | "opaque" | "error";
        /**
         * ContextsRequest
         * @description Runs whose contexts are requested.
         */
        ContextsRequest: {
            /** Runs */
            runs: components["schemas"]["RunAttempt"][];
        };
        /**
         * CredentialKind
         * @description The kind of a credential.
         * @enum {string}
         */
        CredentialKind: "session" | "personal" | "robot" | "runner" | "run";
        /**
         * CredentialRead
         * @description The token or browser session of this request. `is_limited`: it reaches only some projects or missions.
         *
         *     `DELETE /tokens/{id}` ends a token, `DELETE /me/sessions/{id}` a session.
         */
        CredentialRead: {
            /** Expires At */
            expires_at: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Limited */
            is_limited: boolean;
            kind: components["schemas"]["CredentialKind"];
            /** Name */
            name: string;
            /** Scopes */
            scopes: components["schemas"]["Scope"][];
        };
        /**
         * CredentialRef
         * @description The id and name of a token or link.
         */
        CredentialRef: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string;
        };
        /**
         * DeclaredMetric
         * @description A metric that an action reports. `unit` is that of values which are reported without one.
         */
        DeclaredMetric: {
            /** @default none */
            better: components["schemas"]["Better"];
            /**
             * Description
             * @default
             */
            description: string;
            /** Name */
            name: string;
            /** Unit */
            unit?: string | null;
        };
        /**
         * Deduplicated
         * @description The server already has these bytes, and you may read them. The file now exists; send nothing.
         */
        Deduplicated: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            decision: "deduplicated";
            file: components["schemas"]["FileRead"];
        };
        /**
         * Deleted
         * @description What a deletion moved to the trash (or, as a dry run, would move).
         *
         *     For a single file: how many runs read it, and at most 100 files of the mission that they made from it, which stay.
         */
        Deleted: {
            /** Dry Run */
            dry_run: boolean;
            /** Files */
            files: number;
            /**
             * Made From It
             * @default []
             */
            made_from_it: string[];
            /** Missions */
            missions: number;
            /**
             * Read By Runs
             * @default 0
             */
            read_by_runs: number;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * Density
         * @description The number of messages in equal bins of log time.
         *
         *     `counts[k]` covers `start_ns + k * bin_ns` (inclusive) to `start_ns + (k + 1) * bin_ns` (exclusive). `bin_ns` is a
         *     power of two, and `start_ns` a multiple of it. Implausible timestamps are in no bin.
         */
        Density: {
            /** Bin Ns */
            bin_ns: number;
            /** Counts */
            counts: number[];
            /** Start Ns */
            start_ns: number;
        };
        /**
         * Departure
         * @description What ended when a person was deactivated, and the projects that went to the admins.
         */
        Departure: {
            /** Links */
            links: number;
            person: components["schemas"]["PersonRef"];
            /** Projects */
            projects: string[];
            /** Sessions */
            sessions: number;
            /** Tokens */
            tokens: number;
        };
        /**
         * DerivedTokens
         * @description What happens to tokens that were created with a revoked token.
         * @enum {string}
         */
        DerivedTokens: "ended" | "valid";
        /**
         * DeviceBegin
         * @description Request a code to type on another machine: `POST /auth/device`.
         */
        DeviceBegin: {
            /**
             * Client
             * @default klein
             */
            client: string;
        };
        /**
         * DeviceCode
         * @description The code to type, where, and how to poll for the result.
         */
        DeviceCode: {
            /** Device Code */
            device_code: string;
            /** Expires S */
            expires_s: number;
            /** Interval S */
            interval_s: number;
            /** User Code */
            user_code: string;
            /** Verification Url */
            verification_url: string;
            /** Verification Url Complete */
            verification_url_complete: string;
        };
        /**
         * DeviceDecision
         * @description Approve or deny a token for the program that shows this code: `POST /auth/device/approve` or `/deny`.
         */
        DeviceDecision: {
            /** User Code */
            user_code: string;
        };
        /**
         * DeviceExchange
         * @description Poll for the result: `POST /auth/device/token`.
         */
        DeviceExchange: {
            /** Device Code */
            device_code: string;
        };
        /**
         * DeviceRead
         * @description The program that shows a code: `POST /auth/device/status`.
         */
        DeviceRead: {
            /** Address */
            address: string | null;
            /** Client */
            client: string;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
        };
        /**
         * DownloadLink
         * @description A URL to GET the bytes of a file from before `expires_at`, with or without a Range header.
         */
        DownloadLink: {
            /** Crc64Nvme */
            crc64nvme: string | null;
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /**
             * File Id
             * Format: uuid
             */
            file_id: string;
            /** Path */
            path: string;
            /** Sha256 */
            sha256: string | null;
            /** Size Bytes */
            size_bytes: number;
            state: components["schemas"]["BlobState"];
            /** Url */
            url: string;
        };
        /**
         * DownloadLinks
         * @description URLs of files, in the requested order.
         */
        DownloadLinks: {
            /** Items */
            items: components["schemas"]["DownloadLink"][];
        };
        /**
         * DownloadRequest
         * @description Files to download or preview; the audit log contains the purpose.
         */
        DownloadRequest: {
            /** File Ids */
            file_ids: string[];
            /** @default download */
            purpose: components["schemas"]["FetchPurpose"];
        };
        /**
         * EndReason
         * @description Why a run ended. `done` and `exit_code` come from the command itself.
         * @enum {string}
         */
        EndReason: "done" | "exit_code" | "signal" | "memory" | "time" | "disk" | "cancelled" | "command_not_found" | "image_unavailable" | "not_possible" | "inputs_unavailable" | "broken_report" | "results_not_stored" | "lost";
        /**
         * Erasure
         * @description What the erasure of a person ended, and where their name is still mentioned, which stays as it is.
         *
         *     `audit_events` is the number of events in which it was replaced; null until a job has done that. The counts and
         *     mentions are null when the person was erased before.
         */
        Erasure: {
            /** Audit Events */
            audit_events: number | null;
            /**
             * Erased At
             * Format: date-time
             */
            erased_at: string;
            /** Links */
            links?: number | null;
            /** Mentions */
            mentions?: components["schemas"]["Mention"][] | null;
            person: components["schemas"]["PersonRef"];
            /** Projects */
            projects?: string[] | null;
            /** Sessions */
            sessions?: number | null;
            /** Tokens */
            tokens?: number | null;
        };
        /**
         * ErrorCode
         * @description The closed set of failures.
         * @enum {string}
         */
        ErrorCode: "not_authenticated" | "sign_in_pending" | "slow_down" | "sign_in_denied" | "sign_in_expired" | "sign_in_failed" | "sign_in_refused" | "sign_in_too_old" | "second_factor_needed" | "second_factor_wrong" | "code_gone" | "provider_unavailable" | "last_sign_in_method" | "forbidden" | "scope_missing" | "token_too_wide" | "right_exceeded" | "last_owner" | "last_admin" | "group_fixed" | "person_erased" | "not_found" | "wrong_client" | "ambiguous_name" | "name_taken" | "not_from_library" | "edit_conflict" | "invalid_request" | "invalid_query" | "invalid_cursor" | "yaml_invalid" | "fields_invalid" | "metadata_invalid" | "body_too_large" | "method_not_allowed" | "file_exists" | "path_conflict" | "name_leased" | "upload_gone" | "upload_incomplete" | "checksum_mismatch" | "file_unavailable" | "cannot_slice" | "quota_exceeded" | "run_gone" | "no_inputs" | "no_runner" | "rate_limited" | "too_many_streams" | "too_many_slices" | "store_unavailable" | "database_unavailable" | "internal_error";
        /**
         * EventFileRef
         * @description The file that an event refers to.
         */
        EventFileRef: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Path */
            path: string;
        };
        /**
         * EventRecordingRef
         * @description The recording that an event refers to.
         */
        EventRecordingRef: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string;
        };
        /**
         * EventReference
         * @description What an event is of: all of its mission, or one file or recording.
         * @enum {string}
         */
        EventReference: "mission" | "file" | "recording";
        /**
         * ExecutorAbilities
         * @description What an executor supports.
         *
         *     `images`: it runs container images, not only scripts. `environments`: it installs locked dependencies of scripts.
         */
        ExecutorAbilities: {
            /** Bounds Disk */
            bounds_disk: boolean;
            /** Bounds Memory */
            bounds_memory: boolean;
            /**
             * Environments
             * @default false
             */
            environments: boolean;
            /** Executor */
            executor: string;
            /** Gpus */
            gpus: boolean;
            /** Images */
            images: boolean;
            isolation: components["schemas"]["Isolation"];
            /** Networks */
            networks: components["schemas"]["Network"][];
        };
        /**
         * Facet
         * @description The files by `name`: `project`, `format`, `content`, `topic`, `type`, `label`, `month` or `meta.FIELD`.
         *
         *     Or by `verdict`, that of the mission, or `check`, a check of the mission that fails.
         *
         *     The most frequent values come first, months the latest first; `value_count` is the number of all values.
         */
        Facet: {
            /** Name */
            name: string;
            /** Value Count */
            value_count: number;
            /** Values */
            values: components["schemas"]["FacetValue"][];
        };
        /**
         * FacetsRead
         * @description The facets of a query. If `is_exact` is false, they cover only the first `file_count` files.
         */
        FacetsRead: {
            /** Facets */
            facets: components["schemas"]["Facet"][];
            /** File Count */
            file_count: number;
            /** Is Exact */
            is_exact: boolean;
            /** Query */
            query: string;
        };
        /**
         * FacetValue
         * @description A value of a facet. `query` is the text with this value selected, or deselected if it is selected.
         *
         *     `file_count` is the number of matching files that have it, whatever else of the same facet is selected.
         */
        FacetValue: {
            /** File Count */
            file_count: number;
            /** Is Selected */
            is_selected: boolean;
            /** Query */
            query: string;
            /** Value */
            value: string;
        };
        /**
         * FailedChecks
         * @description The number of visible missions that became bad since Monday (`since`, in UTC), and the latest of them.
         */
        FailedChecks: {
            /** Count */
            count: number;
            /** Missions */
            missions: components["schemas"]["MissionRef"][];
            /**
             * Since
             * Format: date-time
             */
            since: string;
        };
        /**
         * FailedJob
         * @description A job that failed for the last time. `ref` is the id of its object; the worker's log has more than `error`.
         */
        FailedJob: {
            /** Attempts */
            attempts: number;
            /** Error */
            error: string | null;
            /** Failed At */
            failed_at: string | null;
            /** Id */
            id: number;
            /** Kind */
            kind: string;
            /** Ref */
            ref: string | null;
        };
        /**
         * FetchPurpose
         * @description What the URLs of files are for, according to the caller. Both give access to all bytes.
         * @enum {string}
         */
        FetchPurpose: "download" | "preview";
        /**
         * FieldProblem
         * @description One invalid field of a request, a metadata document or a field definition.
         */
        FieldProblem: {
            /** Column */
            column?: number | null;
            /** Field */
            field: string;
            /** Line */
            line?: number | null;
            /** Message */
            message: string;
        };
        /**
         * FieldType
         * @description Type of a metadata field.
         * @enum {string}
         */
        FieldType: "string" | "number" | "boolean" | "date" | "location" | "link" | "choice";
        /**
         * FileFact
         * @description A further property of a file, such as the number of poses of a trajectory.
         */
        FileFact: {
            /** Name */
            name: string;
            /** Unit */
            unit: string;
            /** Value */
            value: string | number;
        };
        /**
         * FileFilter
         * @description A filter of files; all criteria must match, and of the values in one list, any. Names and paths may be globs.
         *
         *     `project` and `mission` are a name or a glob, `projects` and `missions` names, globs or ids. `where` compares
         *     metadata of the mission, as in `MissionFilter`. Quotes in `text` group words. `format` is that of the content
         *     (`mcap`, `rosbag1`, `db3`, …), whatever the extension. `problem` are codes of quality warnings or globs.
         *     `recorded_*` are compared with the span of the file. `month` is the month (UTC) in which the recording began.
         *     `without` are terms of the query language (see the page on searching), of which none may match.
         */
        FileFilter: {
            /**
             * Check
             * @default []
             */
            check: string[];
            /**
             * Content
             * @default []
             */
            content: components["schemas"]["ContentState"][];
            /**
             * Event
             * @default []
             */
            event: string[];
            /**
             * Finding
             * @default []
             */
            finding: string[];
            /**
             * Format
             * @default []
             */
            format: string[];
            /**
             * Label
             * @default []
             */
            label: string[];
            /** Max Duration Ns */
            max_duration_ns?: number | null;
            /** Max Size Bytes */
            max_size_bytes?: number | null;
            /**
             * Message Type
             * @default []
             */
            message_type: string[];
            /**
             * Metric
             * @default []
             */
            metric: string[];
            /** Min Duration Ns */
            min_duration_ns?: number | null;
            /** Min Size Bytes */
            min_size_bytes?: number | null;
            /** Mission */
            mission?: string | null;
            /** Mission Id */
            mission_id?: string | null;
            /**
             * Missions
             * @default []
             */
            missions: string[];
            /**
             * Month
             * @default []
             */
            month: string[];
            /**
             * Path
             * @default []
             */
            path: string[];
            /**
             * Problem
             * @default []
             */
            problem: string[];
            /** Project */
            project?: string | null;
            /** Project Id */
            project_id?: string | null;
            /**
             * Projects
             * @default []
             */
            projects: string[];
            /** Recorded After */
            recorded_after?: string | null;
            /** Recorded Before */
            recorded_before?: string | null;
            /** Recording Id */
            recording_id?: string | null;
            /**
             * State
             * @default []
             */
            state: components["schemas"]["BlobState"][];
            /** Text */
            text?: string | null;
            /**
             * Topic
             * @default []
             */
            topic: string[];
            /**
             * Verdict
             * @default []
             */
            verdict: components["schemas"]["Verdict"][];
            /**
             * Where
             * @default []
             */
            where: string[];
            /**
             * Without
             * @default []
             */
            without: string[];
        };
        /**
         * FileLabelled
         * @description The result for one file: its labels now, or why they did not change.
         */
        FileLabelled: {
            /**
             * File Id
             * Format: uuid
             */
            file_id: string;
            /** Labels */
            labels: string[] | null;
            problem: components["schemas"]["ProblemDocument"] | null;
        };
        /**
         * FileLoss
         * @description The unreadable part of a damaged recording. `messages` is null if the file does not tell the number.
         */
        FileLoss: {
            /** Bytes */
            bytes: number;
            /** Chunks */
            chunks: number;
            /** Messages */
            messages: number | null;
        };
        /**
         * FileProblem
         * @description A quality warning about a recording.
         */
        FileProblem: {
            /** Code */
            code: string;
            /** Message */
            message: string;
            /** Where */
            where: string;
        };
        /**
         * FileRead
         * @description A file of a mission: its path, its bytes, and their content. Checksums are lower-case hex.
         *
         *     `sha256` is as reported by the uploader until `state` is `verified`; `md5` is null until then. `summarised_at` and
         *     `depth` are null until the server has read the content. `damaged_at` is when the file was found to be lost or
         *     corrupt, `state_reason` how. `origin` is upload, link (to stored bytes), or run: a file that a run made is derived,
         *     and in no sum of what was recorded. `etag` covers the path and the labels.
         */
        FileRead: {
            /** Compression */
            compression: string[];
            content: components["schemas"]["ContentState"];
            /** Content Reason */
            content_reason: string | null;
            /** Crc64Nvme */
            crc64nvme: string | null;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Damaged At */
            damaged_at?: string | null;
            depth: components["schemas"]["ReadDepth"] | null;
            /** End Ns */
            end_ns: number | null;
            /** Etag */
            etag?: string;
            /** Facts */
            facts: components["schemas"]["FileFact"][];
            /** Format */
            format: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Labels */
            labels: string[];
            lost: components["schemas"]["FileLoss"] | null;
            /** Md5 */
            md5: string | null;
            /** Message Count */
            message_count: number | null;
            mission: components["schemas"]["MissionRef"];
            /** Origin */
            origin: string;
            /** Path */
            path: string;
            /** Problems */
            problems: components["schemas"]["FileProblem"][];
            /** Recording Id */
            recording_id: string | null;
            /** Sha256 */
            sha256: string | null;
            /** Size Bytes */
            size_bytes: number;
            /** Start Ns */
            start_ns: number | null;
            state: components["schemas"]["BlobState"];
            /** State Reason */
            state_reason: string | null;
            /** Summarised At */
            summarised_at: string | null;
            uploaded_by: components["schemas"]["PersonRef"];
            /** Verified At */
            verified_at: string | null;
        };
        /**
         * FilesLabelled
         * @description The result for each file, in the requested order.
         */
        FilesLabelled: {
            /** Items */
            items: components["schemas"]["FileLabelled"][];
        };
        /**
         * FileSort
         * @description Orders of a list of files. `path` orders by project, mission and path.
         * @enum {string}
         */
        FileSort: "path" | "-path" | "created" | "-created" | "size" | "-size" | "start" | "-start";
        /**
         * FileThumbnail
         * @description A picture that a camera recorded in a file, of at most 160 by 160 pixels: a JPEG in base64.
         */
        FileThumbnail: {
            /**
             * File Id
             * Format: uuid
             */
            file_id: string;
            /** Jpeg */
            jpeg: string;
        };
        /**
         * FileThumbnails
         * @description The thumbnails of those files that have one, in no order.
         */
        FileThumbnails: {
            /** Items */
            items: components["schemas"]["FileThumbnail"][];
        };
        /**
         * FileUpdate
         * @description Changes of a file; omitted fields stay. `path` renames it, `mission_id` moves it; no bytes are copied.
         */
        FileUpdate: {
            /** Labels */
            labels?: string[] | null;
            /** Mission Id */
            mission_id?: string | null;
            /** Path */
            path?: string | null;
        };
        /**
         * Finding
         * @description An observation of a run. `file` is the path of an input; times are log times, in ns since 1970.
         */
        Finding: {
            /** Code */
            code: string;
            /** File */
            file?: string | null;
            /** Message */
            message: string;
            severity: components["schemas"]["Severity"];
            /** Time Ns */
            time_ns?: number | null;
            /** Topic */
            topic?: string | null;
        };
        /**
         * FindingRead
         * @description A finding, and the run that reported it with its parameters.
         */
        FindingRead: {
            action: components["schemas"]["ActionRef"];
            /** Ended At */
            ended_at: string | null;
            finding: components["schemas"]["Finding"];
            /** Id */
            id: number;
            mission: components["schemas"]["MissionRef"];
            /** Parameters */
            parameters: {
                [key: string]: boolean | number | string;
            };
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
        };
        /**
         * GrantCreate
         * @description A right to grant to exactly one of a person, a group and an address; it replaces their earlier grant there.
         *
         *     Without `expires_at` it has no end.
         */
        GrantCreate: {
            /** Email */
            email?: string | null;
            /** Expires At */
            expires_at?: string | null;
            /** Group Id */
            group_id?: string | null;
            /** Person Id */
            person_id?: string | null;
            right: components["schemas"]["Right"];
        };
        /**
         * Grantee
         * @description Who has a grant. An address has no id, whether or not somebody has it; its name is the address.
         */
        Grantee: {
            /** Id */
            id: string | null;
            kind: components["schemas"]["GranteeKind"];
            /** Name */
            name: string;
        };
        /**
         * GranteeKind
         * @description The kind of a grantee: a person, a group, or the owner of an e-mail address.
         * @enum {string}
         */
        GranteeKind: "person" | "group" | "email";
        /**
         * GrantOn
         * @description Object of a grant. A grant on a project applies to all its missions.
         * @enum {string}
         */
        GrantOn: "project" | "mission";
        /**
         * GrantRead
         * @description A granted right. Expired grants have no effect.
         */
        GrantRead: {
            /** Expires At */
            expires_at: string | null;
            /**
             * Granted At
             * Format: date-time
             */
            granted_at: string;
            granted_by: components["schemas"]["PersonRef"] | null;
            /** Has Expired */
            has_expired: boolean;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            on: components["schemas"]["GrantOn"];
            right: components["schemas"]["Right"];
            to: components["schemas"]["Grantee"];
        };
        /**
         * GrantUpdate
         * @description Changes of a grant; omitted fields stay. `expires_at` null removes the end.
         */
        GrantUpdate: {
            /** Expires At */
            expires_at?: string | null;
            right?: components["schemas"]["Right"] | null;
        };
        /**
         * GroupCreate
         * @description A group to create; its creator is the first member and editor.
         */
        GroupCreate: {
            /** Name */
            name: string;
        };
        /**
         * GroupKind
         * @description Source of a group's members.
         *
         *     `person`: always one person. `email`: the person with that verified address. `custom`: added by its editors.
         *     `affiliation`: by the domain of a verified address. `admins`: added by admins.
         * @enum {string}
         */
        GroupKind: "person" | "email" | "custom" | "affiliation" | "admins";
        /**
         * GroupRead
         * @description A group. Expired memberships and deactivated people do not count.
         *
         *     `is_member`, `is_editor` and `expires_at` are the caller's own membership. `domains` and `default_right` are the
         *     settings of an affiliation group. A change with an outdated `etag` is refused.
         */
        GroupRead: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"] | null;
            default_right: components["schemas"]["Right"] | null;
            /** Domains */
            domains: string[];
            /** Etag */
            etag?: string;
            /** Expires At */
            expires_at: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Editor */
            is_editor: boolean;
            /** Is Member */
            is_member: boolean;
            kind: components["schemas"]["GroupKind"];
            /** Member Count */
            member_count: number;
            /** Name */
            name: string;
        };
        /**
         * GroupUpdate
         * @description A group's new name.
         */
        GroupUpdate: {
            /** Name */
            name: string;
        };
        /**
         * HashRequired
         * @description The server has a file with this name or size. Announce the file again with its sha256.
         */
        HashRequired: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            decision: "hash_required";
            /** Path */
            path: string;
        };
        /**
         * Heartbeat
         * @description The state of one run. `samples` are those since the last heartbeat.
         */
        Heartbeat: {
            /** Attempt */
            attempt: number;
            /** Image Digest */
            image_digest?: string | null;
            placement?: components["schemas"]["RunPlacement"] | null;
            progress?: components["schemas"]["Progress"] | null;
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
            /**
             * Samples
             * @default []
             */
            samples: components["schemas"]["UsageSample"][];
            state: components["schemas"]["RunState"];
            usage?: components["schemas"]["Usage"] | null;
        };
        /**
         * HeartbeatReplies
         * @description The leases of runs, and their length from now on. Those of unchanged runs without a reply are active.
         */
        HeartbeatReplies: {
            /** Lease S */
            lease_s: number;
            /** Runs */
            runs: components["schemas"]["HeartbeatReply"][];
        };
        /**
         * HeartbeatReply
         * @description The lease of one run.
         */
        HeartbeatReply: {
            /** Attempt */
            attempt: number;
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
            status: components["schemas"]["LeaseStatus"];
        };
        /**
         * Heartbeats
         * @description The states of all runs of a runner. `unchanged`: those of which an earlier heartbeat said all that is known.
         */
        Heartbeats: {
            /** Runs */
            runs: components["schemas"]["Heartbeat"][];
            /**
             * Unchanged
             * @default []
             */
            unchanged: components["schemas"]["RunAttempt"][];
        };
        /**
         * HomeRead
         * @description `GET /api/v1/home`. Every list is bounded. `failed_checks` is null from earlier servers.
         */
        HomeRead: {
            /** Attention */
            attention: components["schemas"]["Attention"][];
            failed_checks?: components["schemas"]["FailedChecks"] | null;
            /** Missions */
            missions: components["schemas"]["RecentMission"][];
            /** Uploads */
            uploads: components["schemas"]["UnfinishedUpload"][];
        };
        /**
         * HomeStorage
         * @description `GET /api/v1/home/storage`: the largest projects and, for admins, the store.
         */
        HomeStorage: {
            /** Projects */
            projects: components["schemas"]["ProjectStorage"][];
            store: components["schemas"]["StoreUse"] | null;
        };
        /**
         * IdentityRead
         * @description A linked identity: `GET /me/identities`; `DELETE /me/identities/{id}` unlinks it.
         *
         *     `provider` is the title of its provider, null if it left the settings. `is_last`: your last sign-in method.
         */
        IdentityRead: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Email */
            email: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Last */
            is_last: boolean;
            /** Issuer */
            issuer: string;
            /**
             * Last Used At
             * Format: date-time
             */
            last_used_at: string;
            /** Provider */
            provider: string | null;
        };
        /**
         * Inputs
         * @description The input files of an action: those that match all three lists of globs; an empty list matches all.
         *
         *     Files that runs made are inputs only with `derived`. `metadata` names the metadata fields of the mission that the
         *     action reads; with `checks`, it reads the `checks.yaml` of the project, and all metadata, by which its profiles are
         *     chosen. With `reference`, it reads the reference trajectory that the metadata or the `checks.yaml` name, and nothing
         *     else of them. Results depend on the values of what is declared: if one changes, they are outdated.
         */
        Inputs: {
            /**
             * Checks
             * @default false
             */
            checks: boolean;
            /**
             * Derived
             * @default false
             */
            derived: boolean;
            /**
             * Message Types
             * @default []
             */
            message_types: string[];
            /**
             * Metadata
             * @default []
             */
            metadata: string[];
            /**
             * Paths
             * @default []
             */
            paths: string[];
            /**
             * Reference
             * @default false
             */
            reference: boolean;
            /**
             * Topics
             * @default []
             */
            topics: string[];
        };
        /**
         * InputsRequest
         * @description Inputs to fetch.
         */
        InputsRequest: {
            /** Attempt */
            attempt: number;
            /** Paths */
            paths: string[];
        };
        /**
         * InputUrls
         * @description URLs to GET the inputs from before `expires_at`, in the requested order.
         */
        InputUrls: {
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /** Urls */
            urls: string[];
        };
        /**
         * InvitationAccept
         * @description Create the account of an invitation: `POST /auth/invitation`.
         */
        InvitationAccept: {
            /** Code */
            code: string;
            /** Name */
            name?: string | null;
            /** Password */
            password: string;
        };
        /**
         * InvitationCreate
         * @description Invite a person: `POST /people/invitations`. You vouch for the address.
         */
        InvitationCreate: {
            /** Email */
            email: string;
            /** Name */
            name?: string | null;
        };
        /**
         * Isolation
         * @description What separates a run from its machine and from other runs; the strongest class first.
         *
         *     A project has the weakest class that its runs may have, a runner the class of its executor.
         * @enum {string}
         */
        Isolation: "container" | "namespaces" | "none";
        /**
         * JobAmount
         * @description Number of jobs of a kind in a state: `todo`, `doing` or `failed`; `oldest_at`: when the oldest was enqueued.
         */
        JobAmount: {
            /** Count */
            count: number;
            /** Kind */
            kind: string;
            /** Oldest At */
            oldest_at: string | null;
            /** State */
            state: string;
        };
        JsonValue: unknown;
        /**
         * LabelChange
         * @description Labels to add to files and to remove; a label in both is added.
         */
        LabelChange: {
            /**
             * Add
             * @default []
             */
            add: string[];
            /** File Ids */
            file_ids: string[];
            /**
             * Remove
             * @default []
             */
            remove: string[];
        };
        /**
         * LeaseStatus
         * @description The lease of a run: renewed; renewed, and the run is to be cancelled; or no longer this runner's.
         * @enum {string}
         */
        LeaseStatus: "active" | "cancel" | "lost";
        /**
         * LibraryActionRead
         * @description An action of the library. `name` is that of its library, `kleinkram/preview`; `version` that of Kleinkram.
         *
         *     `action_id` and `action_version` are the action of that name which the project or the lab has, in its latest
         *     version.
         */
        LibraryActionRead: {
            /** Action Id */
            action_id: string | null;
            /** Action Version */
            action_version: number | null;
            /** Dependencies */
            dependencies: string[];
            /** Description */
            description: string;
            inputs: components["schemas"]["Inputs"];
            /** Metrics */
            metrics: components["schemas"]["DeclaredMetric"][];
            /** Name */
            name: string;
            network: components["schemas"]["Network"];
            /** Parameters */
            parameters: components["schemas"]["Parameter"][];
            /** Requires Python */
            requires_python: string | null;
            resources: components["schemas"]["Resources"];
            right: components["schemas"]["Right"];
            state: components["schemas"]["LibraryState"];
            /** Version */
            version: string;
        };
        /**
         * LibraryAdd
         * @description Where to add an action of the library: in a project, or without one for the whole lab.
         */
        LibraryAdd: {
            /** Project Id */
            project_id?: string | null;
        };
        /**
         * LibraryRead
         * @description All actions of the library, by name.
         */
        LibraryRead: {
            /** Items */
            items: components["schemas"]["LibraryActionRead"][];
        };
        /**
         * LibraryState
         * @description Whether a project, or the whole lab, has an action of the library.
         *
         *     `available`: it has none of that name. `added`: it has what is shipped. `outdated`: adding it again publishes the
         *     next version. `name_taken`: its latest version of that name is not from the library.
         * @enum {string}
         */
        LibraryState: "available" | "added" | "outdated" | "name_taken";
        /**
         * LineageFile
         * @description A file in a lineage. `id` is null where it no longer exists or is not visible to the reader.
         */
        LineageFile: {
            /** Id */
            id: string | null;
            /** Path */
            path: string;
            /** Sha256 */
            sha256: string;
        };
        /**
         * LineageRead
         * @description The run that produced a file and the runs that read it; `truncated` where more runs read it.
         */
        LineageRead: {
            file: components["schemas"]["LineageFile"];
            made_by: components["schemas"]["LineageRun"] | null;
            /** Read By */
            read_by: components["schemas"]["LineageRun"][];
            /** Truncated */
            truncated: boolean;
        };
        /**
         * LineageRun
         * @description A run in a lineage: its inputs, and the files of the mission that were created from its artifacts.
         */
        LineageRun: {
            /** Artifact Count */
            artifact_count: number;
            /** Files */
            files: components["schemas"]["LineageFile"][];
            /** Inputs */
            inputs: components["schemas"]["LineageFile"][];
            run: components["schemas"]["RunRead"];
        };
        /**
         * Location
         * @description A place on earth in degrees (WGS 84); altitude in metres above the ellipsoid.
         */
        Location: {
            /** Altitude */
            altitude?: number | null;
            /** Latitude */
            latitude: number;
            /** Longitude */
            longitude: number;
            /** Name */
            name?: string | null;
        };
        /**
         * LogChunkConfirm
         * @description A chunk of the log that was uploaded and becomes visible.
         */
        LogChunkConfirm: {
            /** Attempt */
            attempt: number;
            /** Offset */
            offset: number;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * LogChunkCreate
         * @description A chunk of the log to upload: its offset in the log, its size and its checksums.
         */
        LogChunkCreate: {
            /** Attempt */
            attempt: number;
            /** Crc64Nvme */
            crc64nvme: string;
            /** Md5 */
            md5: string;
            /** Offset */
            offset: number;
            /** Sha256 */
            sha256: string;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * LogChunkRead
         * @description A chunk of the log of a run from the byte `offset` on; the next one begins at `next_offset`.
         *
         *     It ends with a complete line, unless the log ends or the line is very long. `is_over`: the log ends there.
         */
        LogChunkRead: {
            /** Attempt */
            attempt: number;
            /** Is Over */
            is_over: boolean;
            /** Next Offset */
            next_offset: number;
            /** Offset */
            offset: number;
            /** Text */
            text: string;
        };
        /**
         * LogChunkUpload
         * @description Where to PUT the bytes of a chunk, with exactly these headers; confirm the chunk afterwards.
         */
        LogChunkUpload: {
            /** Headers */
            headers: {
                [key: string]: string;
            };
            /** Url */
            url: string;
        };
        /**
         * LoopbackApproval
         * @description Approve a token for a program on this machine, which listens on 127.0.0.1:`port`: `POST /auth/cli/approve`.
         */
        LoopbackApproval: {
            /**
             * Client
             * @default klein
             */
            client: string;
            /** Code Challenge */
            code_challenge: string;
            /** Port */
            port: number;
            /** State */
            state: string;
        };
        /**
         * LoopbackApproved
         * @description The URL that delivers the code to the program.
         */
        LoopbackApproved: {
            /** Url */
            url: string;
        };
        /**
         * MapTiles
         * @description The tiles of maps: `{z}`, `{x}` and `{y}` in `url` stand for zoom, column and row (Web Mercator, 256 pixels).
         *
         *     Nearer than `max_zoom`, those of `max_zoom` are enlarged. `attribution` is to be shown beside the map.
         */
        MapTiles: {
            /** Attribution */
            attribution: string;
            /** Max Zoom */
            max_zoom: number;
            /** Url */
            url: string;
        };
        /**
         * MemberRead
         * @description A member of a group. Only its editors and admins see `emails`, and members who are not active.
         *
         *     `is_active`: the membership has not expired, and the person is not deactivated. A change with an outdated `etag` is
         *     refused.
         */
        MemberRead: {
            /**
             * Added At
             * Format: date-time
             */
            added_at: string;
            added_by: components["schemas"]["PersonRef"] | null;
            /** Emails */
            emails: string[];
            /** Etag */
            etag?: string;
            /** Expires At */
            expires_at: string | null;
            /** Is Active */
            is_active: boolean;
            /** Is Editor */
            is_editor: boolean;
            person: components["schemas"]["PersonRef"];
        };
        /**
         * MemberSet
         * @description A membership. Editors may change the members. Without `expires_at` there is no end.
         */
        MemberSet: {
            /** Expires At */
            expires_at?: string | null;
            /**
             * Is Editor
             * @default false
             */
            is_editor: boolean;
        };
        /**
         * Mention
         * @description A text in which a person's name or address is found: which of its fields, and of which object.
         *
         *     The `name` of a run is that of its mission.
         */
        Mention: {
            /** Fields */
            fields: string[];
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string;
            resource_type: components["schemas"]["MentionPlace"];
        };
        /**
         * MentionPlace
         * @description The kind of an object with a text that contains somebody's name or address.
         * @enum {string}
         */
        MentionPlace: "project" | "mission" | "file" | "action" | "run" | "group" | "share";
        /**
         * MeRead
         * @description The caller: `GET /me`. `is_admin`: with admin rights, by this credential.
         */
        MeRead: {
            credential: components["schemas"]["CredentialRead"];
            /** Emails */
            emails: string[];
            /** Groups */
            groups: string[];
            /** Is Admin */
            is_admin: boolean;
            person: components["schemas"]["PersonRef"];
        };
        /**
         * MetadataField
         * @description One field that a project declares.
         *
         *     `unit` is for numbers, `pattern` (Rust regex syntax, for the entire value) for strings, `choices` for choices.
         */
        MetadataField: {
            /** Choices */
            choices?: string[] | null;
            /** Default */
            default?: boolean | number | string | components["schemas"]["Location"] | null;
            /**
             * Description
             * @default
             */
            description: string;
            /** Name */
            name: string;
            /** Pattern */
            pattern?: string | null;
            /**
             * Required
             * @default false
             */
            required: boolean;
            type: components["schemas"]["FieldType"];
            /** Unit */
            unit?: string | null;
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
        MetadataFields: {
            /**
             * Fields
             * @default []
             */
            fields: components["schemas"]["MetadataField"][];
            /** @default accept */
            undeclared: components["schemas"]["Undeclared"];
        };
        /**
         * Metric
         * @description A number that a run measured, of the whole mission or of a file or topic.
         *
         *     `labels` distinguish numbers of one name, such as `{"method": "kiss-icp"}`. A later one of the same name, file,
         *     topic and labels replaces an earlier one.
         */
        Metric: {
            /** File */
            file?: string | null;
            /**
             * Labels
             * @default {}
             */
            labels: {
                [key: string]: string;
            };
            /** Name */
            name: string;
            /** Topic */
            topic?: string | null;
            /** Unit */
            unit?: string | null;
            /** Value */
            value: number;
        };
        /**
         * MetricCell
         * @description A cell. `count` is the number of values, `run_count` that of their runs, of which `run_ids` are at most 20.
         *
         *     Where there is no value, `missing` says why, and `run_ids` names a run behind that, if there is one.
         */
        MetricCell: {
            /**
             * Count
             * @default 0
             */
            count: number;
            missing?: components["schemas"]["Missing"] | null;
            rank?: components["schemas"]["Rank"] | null;
            /**
             * Run Count
             * @default 0
             */
            run_count: number;
            /**
             * Run Ids
             * @default []
             */
            run_ids: string[];
            /** Value */
            value?: number | null;
        };
        /**
         * MetricColumn
         * @description A column. `values` are by dimension; null where a result has none, such as no topic.
         */
        MetricColumn: {
            /** Action Id */
            action_id?: string | null;
            /** Label */
            label: string;
            /** Values */
            values: {
                [key: string]: boolean | number | string | null;
            };
        };
        /**
         * MetricComparison
         * @description The second column compared with the first, row by row.
         *
         *     `differences` (second minus first) are by row, null where one of both has no value. Wins are rows in which the
         *     second is better; they are null where neither direction is.
         */
        MetricComparison: {
            /** Differences */
            differences: (number | null)[];
            /** First */
            first: number;
            /** Losses */
            losses: number | null;
            /** Mean Difference */
            mean_difference: number | null;
            /** Median Difference */
            median_difference: number | null;
            /** Pair Count */
            pair_count: number;
            /** Second */
            second: number;
            /** Ties */
            ties: number;
            /** Wins */
            wins: number | null;
        };
        /**
         * MetricDimension
         * @description What could distinguish columns: a name such as `param.method`, and its number of values in these results.
         */
        MetricDimension: {
            /** Name */
            name: string;
            /** Value Count */
            value_count: number;
        };
        /**
         * MetricName
         * @description A metric that runs reported, as their actions declare it.
         */
        MetricName: {
            better: components["schemas"]["Better"];
            /** Description */
            description: string;
            /** Name */
            name: string;
            /** Run Count */
            run_count: number;
            /** Unit */
            unit: string | null;
        };
        /**
         * MetricNames
         * @description The metrics that runs reported, by name; `truncated` where there are more than 1000.
         */
        MetricNames: {
            /** Items */
            items: components["schemas"]["MetricName"][];
            /** Truncated */
            truncated: boolean;
        };
        /**
         * MetricRead
         * @description A metric, and the run that reported it with its parameters.
         */
        MetricRead: {
            action: components["schemas"]["ActionRef"];
            /** Ended At */
            ended_at: string | null;
            /** Id */
            id: number;
            metric: components["schemas"]["Metric"];
            mission: components["schemas"]["MissionRef"];
            /** Parameters */
            parameters: {
                [key: string]: boolean | number | string;
            };
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
        };
        /**
         * MetricRow
         * @description A row. `label` is null for missions without the metadata field. `mission` and `project` are what it is about.
         */
        MetricRow: {
            /** Cells */
            cells: components["schemas"]["MetricCell"][];
            /** Label */
            label: string | null;
            mission?: components["schemas"]["MissionRef"] | null;
            project?: components["schemas"]["ProjectRef"] | null;
        };
        /**
         * MetricTableRead
         * @description A table of a metric. Columns are in the order of their values, rows of their labels.
         *
         *     `varying` names what differs between results of one column and is no column itself. `dimensions` are those of which
         *     the results have several values.
         */
        MetricTableRead: {
            aggregate: components["schemas"]["Aggregate"];
            better: components["schemas"]["Better"];
            /** Column Dimensions */
            column_dimensions: string[];
            /** Columns */
            columns: components["schemas"]["MetricColumn"][];
            comparison?: components["schemas"]["MetricComparison"] | null;
            /** Description */
            description: string;
            /** Dimensions */
            dimensions: components["schemas"]["MetricDimension"][];
            /** Metric */
            metric: string;
            /** Row Group */
            row_group: string;
            /** Rows */
            rows: components["schemas"]["MetricRow"][];
            /** Text */
            text?: string | null;
            /** Unit */
            unit: string | null;
            /** Varying */
            varying: string[];
        };
        /**
         * Missing
         * @description Why a cell has no value: the runs that would fill it.
         * @enum {string}
         */
        Missing: "no_run" | "running" | "failed" | "cancelled" | "no_metric";
        /**
         * MissionCheck
         * @description The outcome of one check of a mission, as in `Check`.
         *
         *     `action`, `action_version` and `run_id` name the run that made it; without an account, `run_id` is not shown.
         *     `acceptance_id`: a person accepted that it fails, so that it does not count.
         */
        MissionCheck: {
            /** Acceptance Id */
            acceptance_id?: string | null;
            /** Action */
            action?: string | null;
            /** Action Version */
            action_version?: number | null;
            /** File */
            file?: string | null;
            /** Limit */
            limit?: number | null;
            /** Message */
            message: string;
            /** Name */
            name: string;
            /** Run Id */
            run_id?: string | null;
            /** @default server */
            source: components["schemas"]["CheckSource"];
            status: components["schemas"]["CheckStatus"];
            /** Time Ns */
            time_ns?: number | null;
            /** Topic */
            topic?: string | null;
            /** Unit */
            unit?: string | null;
            /** Value */
            value?: number | null;
        };
        /**
         * MissionChecksRead
         * @description One page of the checks of a mission, worst first, and its verdict and counts by all of them.
         *
         *     `next` is the cursor of the next page, null on the last; acceptances, notes and reports come with the first one.
         *     `evaluated_at` is null while nothing was checked.
         *     `is_current`: the checks are of the present files and by the present `checks.yaml`, whose version is `checks_number`
         *     (0 for none). `reference` is the trajectory that estimates are compared with: of the mission's metadata, or else of
         *     the first profile that applies and names one; it comes with the first page. `bad_since` is when the mission became
         *     bad. With `all`, acceptances that ended are listed too. Without an account, there are no notes and no reports, and
         *     only acceptances that apply.
         */
        MissionChecksRead: {
            /** Acceptances */
            acceptances: components["schemas"]["CheckAcceptanceRead"][];
            /** Bad Since */
            bad_since: string | null;
            /** Checks */
            checks: components["schemas"]["MissionCheck"][];
            /** Checks Number */
            checks_number: number;
            counts: components["schemas"]["CheckCounts"];
            /** Evaluated At */
            evaluated_at: string | null;
            /** Is Current */
            is_current: boolean;
            /** Next */
            next?: string | null;
            /** Notes */
            notes: components["schemas"]["CheckNoteRead"][];
            /** Profiles Applied */
            profiles_applied: string[];
            /** Profiles Left Out */
            profiles_left_out: components["schemas"]["ProfileLeftOut"][];
            /** Reference */
            reference?: string | null;
            /** Reports */
            reports: components["schemas"]["CheckReportRead"][];
            verdict: components["schemas"]["Verdict"];
        };
        /**
         * MissionCreate
         * @description A mission to create, whose metadata must satisfy the project's fields.
         *
         *     The metadata is a YAML document, `metadata_yaml`, which is stored unchanged, or values, `metadata`.
         */
        MissionCreate: {
            /** Metadata */
            metadata?: {
                [key: string]: components["schemas"]["JsonValue"];
            } | null;
            /** Metadata Yaml */
            metadata_yaml?: string | null;
            /** Name */
            name: string;
            /**
             * Notes
             * @default
             */
            notes: string;
        };
        /**
         * MissionEventCreate
         * @description An event to add to a mission: a moment, or a span where `end_ns` is later than `start_ns`.
         *
         *     Times are log times, in ns since 1970. It may refer to a file or a recording of the mission, and to a topic.
         *     `finding_id` is the finding of a run from which it is made. If the mission has an event with the `id` or of the
         *     finding, nothing is added, and that event is returned: a request that is sent again does not double an event.
         */
        MissionEventCreate: {
            /** Colour */
            colour?: string | null;
            /** End Ns */
            end_ns?: number | null;
            /** File Id */
            file_id?: string | null;
            /** Finding Id */
            finding_id?: number | null;
            /** Id */
            id?: string | null;
            /**
             * Labels
             * @default []
             */
            labels: string[];
            /** Name */
            name: string;
            /**
             * Note
             * @default
             */
            note: string;
            /** Recording Id */
            recording_id?: string | null;
            /** Start Ns */
            start_ns: number;
            /** Topic */
            topic?: string | null;
        };
        /**
         * MissionEventRead
         * @description A moment or a span of a mission. Times are log times, in ns since 1970, and both ends belong to a span.
         *
         *     `end_ns` is null for a moment, or equal to the start. `refers_to` is what the event is of. `file` is null also where
         *     that file is in the trash, was moved or is deleted, and `recording` where that recording no longer exists, as when
         *     it got another name: the event is then of nothing in the mission. `run_id` is the run that added it or reported its
         *     finding. `created_by` is null for callers without an account. `etag` covers the edited fields: a change with an
         *     outdated one is refused.
         */
        MissionEventRead: {
            /** Colour */
            colour: string | null;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"] | null;
            /** End Ns */
            end_ns: number | null;
            /** Etag */
            etag?: string;
            file: components["schemas"]["EventFileRef"] | null;
            /** Finding Id */
            finding_id: number | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Labels */
            labels: string[];
            mission: components["schemas"]["MissionRef"];
            /** Name */
            name: string;
            /** Note */
            note: string;
            recording: components["schemas"]["EventRecordingRef"] | null;
            refers_to: components["schemas"]["EventReference"];
            /** Run Id */
            run_id: string | null;
            /** Start Ns */
            start_ns: number;
            /** Topic */
            topic: string | null;
        };
        /**
         * MissionEventSort
         * @description Orders of a list of events.
         * @enum {string}
         */
        MissionEventSort: "start" | "-start" | "created" | "-created";
        /**
         * MissionEventUpdate
         * @description Changes of an event; omitted fields stay. Null removes an end, which makes it a moment, a colour or a reference.
         *
         *     A `file_id` replaces the recording that the event refers to, a `recording_id` the file. Null also removes the
         *     reference to a file or a recording that is gone: the event is of the whole mission then.
         */
        MissionEventUpdate: {
            /** Colour */
            colour?: string | null;
            /** End Ns */
            end_ns?: number | null;
            /** File Id */
            file_id?: string | null;
            /** Labels */
            labels?: string[] | null;
            /** Name */
            name?: string | null;
            /** Note */
            note?: string | null;
            /** Recording Id */
            recording_id?: string | null;
            /** Start Ns */
            start_ns?: number | null;
            /** Topic */
            topic?: string | null;
        };
        /**
         * MissionFile
         * @description An artifact that becomes the file `to` of the mission, made from the inputs `derived_from` (empty: all).
         */
        MissionFile: {
            /**
             * Derived From
             * @default []
             */
            derived_from: string[];
            /** Path */
            path: string;
            /** To */
            to: string;
        };
        /**
         * MissionPicture
         * @description The first picture of a mission of at most 4 MB, with a URL to GET it from before `expires_at`.
         */
        MissionPicture: {
            /**
             * Artifact Id
             * Format: uuid
             */
            artifact_id: string;
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /**
             * Mission Id
             * Format: uuid
             */
            mission_id: string;
            /** Path */
            path: string;
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
            /** Size Bytes */
            size_bytes: number;
            /** Title */
            title: string;
            /** Url */
            url: string;
        };
        /**
         * MissionPictures
         * @description The pictures of those missions that have one, in no order; of the others, a thumbnail if cameras recorded.
         */
        MissionPictures: {
            /** Items */
            items: components["schemas"]["MissionPicture"][];
            /** Thumbnails */
            thumbnails: components["schemas"]["MissionThumbnail"][];
        };
        /**
         * MissionPosition
         * @description Where a mission is on the map, in degrees (WGS 84).
         */
        MissionPosition: {
            /** Latitude */
            latitude: number;
            /** Longitude */
            longitude: number;
            mission: components["schemas"]["MissionRef"];
            source: components["schemas"]["PositionSource"];
        };
        /**
         * MissionPositions
         * @description The positions of the 2,000 missions that were recorded last, of those that match.
         *
         *     `unplaced_count` of these have no known position; `left_out_count` are the earlier missions that match.
         */
        MissionPositions: {
            /** Items */
            items: components["schemas"]["MissionPosition"][];
            /** Left Out Count */
            left_out_count: number;
            /** Unplaced Count */
            unplaced_count: number;
        };
        /**
         * MissionPreview
         * @description An artifact that the latest run of an action shows of its mission.
         *
         *     `run_id` is the run that made it at `made_at`, which a later one may reuse. `outdated`: what the action reads has
         *     changed since: files, or the metadata, checks and reference that it declares.
         */
        MissionPreview: {
            action: components["schemas"]["ActionRef"];
            /**
             * Artifact Id
             * Format: uuid
             */
            artifact_id: string;
            kind: components["schemas"]["PreviewKind"];
            /**
             * Made At
             * Format: date-time
             */
            made_at: string;
            /** Outdated */
            outdated: boolean;
            /** Path */
            path: string;
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
            /** Sha256 */
            sha256: string;
            /** Size Bytes */
            size_bytes: number;
            /** Title */
            title: string;
        };
        /**
         * MissionPreviews
         * @description The first 100 previews of a mission: those of the action `preview`, then those that were made last.
         *
         *     Of each action, by its name, these are the previews of the latest run that is done and has any. Those whose bytes
         *     are lost or corrupt are left out. `truncated`: there are more.
         */
        MissionPreviews: {
            /** Items */
            items: components["schemas"]["MissionPreview"][];
            /** Truncated */
            truncated: boolean;
        };
        /**
         * MissionRead
         * @description A mission and its totals.
         *
         *     `start_ns` and `end_ns` (log time, ns since 1970) span its recordings without implausible timestamps.
         *     `metadata_problems` is what does not satisfy the project's fields. `pending_file_count` is the number of files whose
         *     content the server has not read yet. `recordings_current`: recordings and span reflect the current files. `verdict`
         *     and `checks`: what its checks amount to, and their number by status. `right` is the caller's. `etag` covers the
         *     edited fields: a change with an outdated one is refused.
         */
        MissionRead: {
            /**
             * @default {
             *       "accepted": 0,
             *       "error": 0,
             *       "needs_content": 0,
             *       "not_made": 0,
             *       "ok": 0,
             *       "warning": 0
             *     }
             */
            checks: components["schemas"]["CheckCounts"];
            /** Completed At */
            completed_at: string | null;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"];
            /** End Ns */
            end_ns: number | null;
            /** Etag */
            etag?: string;
            /** File Count */
            file_count: number;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Message Count */
            message_count: number;
            /** Metadata */
            metadata: {
                [key: string]: components["schemas"]["JsonValue"];
            };
            /** Metadata Problems */
            metadata_problems: components["schemas"]["FieldProblem"][];
            /** Metadata Yaml */
            metadata_yaml: string | null;
            /** Name */
            name: string;
            /** Notes */
            notes: string;
            /** Pending File Count */
            pending_file_count: number;
            project: components["schemas"]["ProjectRef"];
            /** Recordings Current */
            recordings_current: boolean;
            right: components["schemas"]["Right"];
            /** Size Bytes */
            size_bytes: number;
            /** Start Ns */
            start_ns: number | null;
            /** @default unchecked */
            verdict: components["schemas"]["Verdict"];
        };
        /**
         * MissionRef
         * @description The id, name and project of a mission.
         */
        MissionRef: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string;
            project: components["schemas"]["ProjectRef"];
        };
        /**
         * MissionSort
         * @description Orders of a list of missions. `verdict`: bad ones first; of one verdict, in both directions, the latest first.
         * @enum {string}
         */
        MissionSort: "name" | "-name" | "created" | "-created" | "start" | "-start" | "verdict" | "-verdict";
        /**
         * MissionTemplate
         * @description Template for the next mission of a project: as YAML, or as a form of `fields` with initial `values`.
         *
         *     `carried` are values of the mission `prefilled_from`, to be confirmed field by field; in the YAML they are comments.
         *     Dates, weather and operator are not carried over.
         */
        MissionTemplate: {
            /**
             * Carried
             * @default {}
             */
            carried: {
                [key: string]: components["schemas"]["JsonValue"];
            };
            fields: components["schemas"]["MetadataFields"];
            prefilled_from: components["schemas"]["MissionRef"] | null;
            /** Values */
            values: {
                [key: string]: components["schemas"]["JsonValue"];
            };
            /** Yaml */
            yaml: string;
        };
        /**
         * MissionThumbnail
         * @description A picture that a camera recorded in a mission, of at most 160 by 160 pixels: a JPEG in base64.
         */
        MissionThumbnail: {
            /**
             * File Id
             * Format: uuid
             */
            file_id: string;
            /** Jpeg */
            jpeg: string;
            /**
             * Mission Id
             * Format: uuid
             */
            mission_id: string;
        };
        /**
         * MissionTimeline
         * @description Files of a mission, by path; `next` is the cursor of those that follow, or null.
         *
         *     `start_ns` and `end_ns` span the mission (log clock, since 1970, UTC), without recordings from before 1990.
         */
        MissionTimeline: {
            /** End Ns */
            end_ns: number | null;
            /** Items */
            items: components["schemas"]["TimelineFile"][];
            /** Next */
            next?: string | null;
            /** Start Ns */
            start_ns: number | null;
        };
        /**
         * MissionTopic
         * @description One topic with one type, in all recordings of a mission.
         *
         *     `other_types`: other types of the same topic in the mission, a conflict. `count` is null if a file has no count.
         *     `rate_hz` and `longest_gap_ns` cover only the time within recordings. `counts` are by the bins of `axis`; null if no
         *     file with the topic has a density, and less than `count` in sum if only some have. `recordings` are ranges
         *     `[first, last]` (inclusive) of indexes in the response's `recordings`.
         */
        MissionTopic: {
            /** Count */
            count: number | null;
            /** Counts */
            counts: number[] | null;
            /** File Count */
            file_count: number;
            /** First Ns */
            first_ns: number | null;
            /** Last Ns */
            last_ns: number | null;
            /** Longest Gap Ns */
            longest_gap_ns: number | null;
            /** Message Type */
            message_type: string | null;
            /** Name */
            name: string;
            /** Other Types */
            other_types: (string | null)[];
            /** Rate Hz */
            rate_hz: number | null;
            /** Recording Count */
            recording_count: number;
            /** Recordings */
            recordings: [
                number,
                number
            ][];
            /** Stored Bytes */
            stored_bytes: number | null;
        };
        /**
         * MissionTopics
         * @description A page of the topics of a mission, by name and type.
         *
         *     `axis` spans the mission without recordings from before 1990; null if no times are known. `recordings` are in
         *     chronological order. `is_current`: it reflects the current files; otherwise it will soon.
         */
        MissionTopics: {
            axis: components["schemas"]["TimeAxis"] | null;
            /** Is Current */
            is_current: boolean;
            /** Items */
            items: components["schemas"]["MissionTopic"][];
            /** Next */
            next?: string | null;
            /** Recordings */
            recordings: components["schemas"]["RecordingRef"][];
        };
        /**
         * MissionUpdate
         * @description Changes of a mission; omitted fields stay. A new `project_id` moves the mission with its files.
         *
         *     `metadata_yaml` replaces all metadata; with `merge_yaml`, it changes only the fields that it contains. `metadata`
         *     changes the fields that it contains and drops the stored YAML document. A field with the value null is removed.
         */
        MissionUpdate: {
            /** Completed */
            completed?: boolean | null;
            /** Merge Yaml */
            merge_yaml?: boolean | null;
            /** Metadata */
            metadata?: {
                [key: string]: components["schemas"]["JsonValue"];
            } | null;
            /** Metadata Yaml */
            metadata_yaml?: string | null;
            /** Name */
            name?: string | null;
            /** Notes */
            notes?: string | null;
            /** Project Id */
            project_id?: string | null;
        };
        /**
         * NamedRef
         * @description The id and name of an object.
         */
        NamedRef: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string;
        };
        /**
         * Network
         * @description Network access of a run: none, the API and the store with its own token, or that of its machine.
         * @enum {string}
         */
        Network: "none" | "api" | "open";
        /**
         * NotCompleted
         * @description The upload could not be finished; the problem says why and what to do.
         */
        NotCompleted: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            outcome: "refused";
            problem: components["schemas"]["ProblemDocument"];
            /**
             * Upload Id
             * Format: uuid
             */
            upload_id: string;
        };
        /**
         * OneTimeLink
         * @description A one-time link. `warning`: what its use changes for others, and what to do before.
         */
        OneTimeLink: {
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /** Url */
            url: string;
            /** Warning */
            warning?: string | null;
        };
        /**
         * Overview
         * @description Totals of a project, or of everything visible, by `month` of recording or by a metadata field.
         *
         *     Months and numbers are in ascending order; other values by recorded time, longest first, as many as requested, and
         *     `other` is the rest. `unit` is that of a number field. `topics` is the number of distinct topic names; null if the
         *     caller may see only parts of missions.
         */
        Overview: {
            /** Buckets */
            buckets: components["schemas"]["Bucket"][];
            /** By */
            by: string;
            other: components["schemas"]["StatsRow"] | null;
            /** Topics */
            topics: number | null;
            total: components["schemas"]["StatsRow"];
            /** Unit */
            unit: string | null;
        };
        /** Page[AccessRead] */
        Page_AccessRead_: {
            /** Items */
            items: components["schemas"]["AccessRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[ActionRead] */
        Page_ActionRead_: {
            /** Items */
            items: components["schemas"]["ActionRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[ActionVersionRead] */
        Page_ActionVersionRead_: {
            /** Items */
            items: components["schemas"]["ActionVersionRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[ArtifactRead] */
        Page_ArtifactRead_: {
            /** Items */
            items: components["schemas"]["ArtifactRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[AuditRead] */
        Page_AuditRead_: {
            /** Items */
            items: components["schemas"]["AuditRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[CheckRead] */
        Page_CheckRead_: {
            /** Items */
            items: components["schemas"]["CheckRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[ChecksVersionRead] */
        Page_ChecksVersionRead_: {
            /** Items */
            items: components["schemas"]["ChecksVersionRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[FileRead] */
        Page_FileRead_: {
            /** Items */
            items: components["schemas"]["FileRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[FindingRead] */
        Page_FindingRead_: {
            /** Items */
            items: components["schemas"]["FindingRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[GrantRead] */
        Page_GrantRead_: {
            /** Items */
            items: components["schemas"]["GrantRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[GroupRead] */
        Page_GroupRead_: {
            /** Items */
            items: components["schemas"]["GroupRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[MemberRead] */
        Page_MemberRead_: {
            /** Items */
            items: components["schemas"]["MemberRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[MetricRead] */
        Page_MetricRead_: {
            /** Items */
            items: components["schemas"]["MetricRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[MissionEventRead] */
        Page_MissionEventRead_: {
            /** Items */
            items: components["schemas"]["MissionEventRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[MissionRead] */
        Page_MissionRead_: {
            /** Items */
            items: components["schemas"]["MissionRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[PersonRead] */
        Page_PersonRead_: {
            /** Items */
            items: components["schemas"]["PersonRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[ProjectRead] */
        Page_ProjectRead_: {
            /** Items */
            items: components["schemas"]["ProjectRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[RecordingRead] */
        Page_RecordingRead_: {
            /** Items */
            items: components["schemas"]["RecordingRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[RunInput] */
        Page_RunInput_: {
            /** Items */
            items: components["schemas"]["RunInput"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[RunnerRead] */
        Page_RunnerRead_: {
            /** Items */
            items: components["schemas"]["RunnerRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[RunRead] */
        Page_RunRead_: {
            /** Items */
            items: components["schemas"]["RunRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[SessionRead] */
        Page_SessionRead_: {
            /** Items */
            items: components["schemas"]["SessionRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[ShareRead] */
        Page_ShareRead_: {
            /** Items */
            items: components["schemas"]["ShareRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[TokenRead] */
        Page_TokenRead_: {
            /** Items */
            items: components["schemas"]["TokenRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[TopicFound] */
        Page_TopicFound_: {
            /** Items */
            items: components["schemas"]["TopicFound"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[TopicRead] */
        Page_TopicRead_: {
            /** Items */
            items: components["schemas"]["TopicRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[TrashRead] */
        Page_TrashRead_: {
            /** Items */
            items: components["schemas"]["TrashRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[UploadRead] */
        Page_UploadRead_: {
            /** Items */
            items: components["schemas"]["UploadRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /** Page[ViewerLayoutRead] */
        Page_ViewerLayoutRead_: {
            /** Items */
            items: components["schemas"]["ViewerLayoutRead"][];
            /** Next */
            next?: string | null;
            /** Total */
            total?: number | null;
        };
        /**
         * Parameter
         * @description A parameter of an action; required where it has no default. `minimum` and `maximum` are inclusive.
         */
        Parameter: {
            /** Choices */
            choices?: string[] | null;
            /** Default */
            default?: boolean | number | string | null;
            /**
             * Description
             * @default
             */
            description: string;
            /** Maximum */
            maximum?: number | null;
            /** Minimum */
            minimum?: number | null;
            /** Name */
            name: string;
            type: components["schemas"]["ParameterType"];
            /** Unit */
            unit?: string | null;
        };
        /**
         * ParameterType
         * @description Type of a parameter. A `topic` is a string for which forms offer the topics of the mission.
         * @enum {string}
         */
        ParameterType: "string" | "integer" | "number" | "boolean" | "choice" | "topic";
        /**
         * PartsSign
         * @description Parts to sign, of one or several uploads.
         */
        PartsSign: {
            /** Parts */
            parts: components["schemas"]["PartToSign"][];
        };
        /**
         * PartToSign
         * @description A part to send, with its checksum in lower-case hex, of the kind that the upload specifies.
         */
        PartToSign: {
            /** Checksum */
            checksum: string;
            /** Number */
            number: number;
            /**
             * Upload Id
             * Format: uuid
             */
            upload_id: string;
        };
        /**
         * PasswordChange
         * @description Change your password: `POST /auth/password/change`. Your other browsers are signed out.
         */
        PasswordChange: {
            /** New Password */
            new_password: string;
            /** Old Password */
            old_password: string;
        };
        /**
         * PasswordReauthenticate
         * @description Enter the password again in a signed-in browser: `POST /auth/password/reauthenticate`.
         */
        PasswordReauthenticate: {
            /** Password */
            password: string;
            /** Second Factor */
            second_factor?: string | null;
        };
        /**
         * PasswordReset
         * @description Choose a new password with a reset link: `POST /auth/reset`.
         */
        PasswordReset: {
            /** Code */
            code: string;
            /** Password */
            password: string;
            /** Second Factor */
            second_factor?: string | null;
        };
        /**
         * PasswordSignIn
         * @description Sign in with a local account: `POST /auth/password`. `second_factor`: if the account has one.
         */
        PasswordSignIn: {
            /** Email */
            email: string;
            /** Password */
            password: string;
            /** Second Factor */
            second_factor?: string | null;
        };
        /**
         * PersonErase
         * @description Erase a person: `POST /people/{id}/erase`. `confirmation` is their name, as typed by the admin.
         */
        PersonErase: {
            /** Confirmation */
            confirmation: string;
        };
        /**
         * PersonRead
         * @description A person. `emails`, their verified addresses, are for themselves, admins, and editors of a shared group.
         *
         *     Only admins see deactivated people. The `name` of an erased person is a pseudonym.
         */
        PersonRead: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Deactivated At */
            deactivated_at: string | null;
            /** Emails */
            emails: string[];
            /** Erased At */
            erased_at?: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Admin */
            is_admin: boolean;
            /** Name */
            name: string;
        };
        /**
         * PersonRef
         * @description The id and name of a person.
         */
        PersonRef: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string;
        };
        /**
         * PicturesRequest
         * @description The missions of a list.
         */
        PicturesRequest: {
            /** Mission Ids */
            mission_ids: string[];
        };
        /**
         * PositionSource
         * @description Where the position of a mission is known from.
         * @enum {string}
         */
        PositionSource: "recording" | "metadata";
        /**
         * Preview
         * @description A picture (PNG, JPEG, SVG), table (CSV) or track (GeoJSON) among the artifacts that is shown with the run.
         */
        Preview: {
            /** Path */
            path: string;
            /**
             * Title
             * @default
             */
            title: string;
        };
        /**
         * PreviewKind
         * @description What a preview shows, by the ending of its path: PNG, JPEG or SVG; CSV; GeoJSON; or none of these.
         * @enum {string}
         */
        PreviewKind: "picture" | "table" | "track" | "other";
        /**
         * ProblemDocument
         * @description A failure on the wire (RFC 9457), with the fields of the error's class beside these.
         */
        ProblemDocument: {
            code: components["schemas"]["ErrorCode"];
            /** Detail */
            detail: string;
            /** Request Id */
            request_id?: string | null;
            /** Status */
            status: number;
            /** Title */
            title: string;
            /** Type */
            type: string;
        } & {
            [key: string]: unknown;
        };
        /**
         * ProfileLeftOut
         * @description A profile of `checks.yaml` that does not apply to a mission, and why.
         */
        ProfileLeftOut: {
            /** Name */
            name: string;
            /** Reason */
            reason: string;
        };
        /**
         * Progress
         * @description The progress of a run: `fraction` from 0 to 1, and a message.
         */
        Progress: {
            /** Fraction */
            fraction: number;
            /**
             * Message
             * @default
             */
            message: string;
        };
        /**
         * ProjectActionAdd
         * @description An action that a project names, by the id of a published one. The latest version runs.
         *
         *     `idle_s` is for `idle` only: how long the files of a mission must not have changed, and no upload be under way.
         */
        ProjectActionAdd: {
            /**
             * Action Id
             * Format: uuid
             */
            action_id: string;
            /** Idle S */
            idle_s?: number | null;
            on: components["schemas"]["RunTrigger"];
            /**
             * Parameters
             * @default {}
             */
            parameters: {
                [key: string]: boolean | number | string;
            };
        };
        /**
         * ProjectActionList
         * @description The actions that a project names, by name.
         */
        ProjectActionList: {
            /** Items */
            items: components["schemas"]["ProjectActionRead"][];
        };
        /**
         * ProjectActionRead
         * @description An action that a project names. Its runs act for `added_by`, with their rights at that time.
         *
         *     `problem` is why it last did not run on a mission that was due, and `problem_count` on how many missions.
         */
        ProjectActionRead: {
            action: components["schemas"]["ActionRef"];
            /**
             * Added At
             * Format: date-time
             */
            added_at: string;
            added_by: components["schemas"]["PersonRef"];
            /** Idle S */
            idle_s: number | null;
            on: components["schemas"]["RunTrigger"];
            /** Parameters */
            parameters: {
                [key: string]: boolean | number | string;
            };
            /** Problem */
            problem: string | null;
            /** Problem Count */
            problem_count: number;
        };
        /**
         * ProjectChecksRead
         * @description The `checks.yaml` of a project: `text` is empty while there is none, and `number` is that of its version.
         *
         *     `sha256` is the hash of the text in UTF-8, by which reports name the file that they were made by. `created_at` and
         *     `created_by` are null where there never was a file; `number` is 0 then.
         */
        ProjectChecksRead: {
            /** Created At */
            created_at: string | null;
            created_by: components["schemas"]["PersonRef"] | null;
            /** Etag */
            etag?: string;
            /** Number */
            number: number;
            /** Sha256 */
            sha256: string;
            /** Text */
            text: string;
        };
        /**
         * ProjectChecksUpdate
         * @description The new `checks.yaml` of a project; an empty text removes it.
         */
        ProjectChecksUpdate: {
            /** Text */
            text: string;
        };
        /**
         * ProjectCreate
         * @description A project to create, with its metadata fields as the text of a `fields.yaml` or as `metadata_fields`.
         */
        ProjectCreate: {
            /**
             * Description
             * @default
             */
            description: string;
            /** Fields Yaml */
            fields_yaml?: string | null;
            metadata_fields?: components["schemas"]["MetadataFields"] | null;
            /** Name */
            name: string;
        };
        /**
         * ProjectRead
         * @description A project and its contents, without the trash. `right` is the caller's own.
         *
         *     The quotas limit files and uploads in progress: `used_bytes` and `used_files`. `etag` is of the edited fields.
         *     `isolation` is the weakest class that its runs may have; where the server asks for a stronger one, that counts.
         */
        ProjectRead: {
            /** Citation */
            citation: string;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"];
            /** Description */
            description: string;
            /** Duration Ns */
            duration_ns: number;
            /** Etag */
            etag?: string;
            /** File Count */
            file_count: number;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Public */
            is_public: boolean;
            /** @default container */
            isolation: components["schemas"]["Isolation"];
            /** Licence */
            licence: string;
            metadata_fields: components["schemas"]["MetadataFields"];
            /** Mission Count */
            mission_count: number;
            /** Name */
            name: string;
            /** Quota Bytes */
            quota_bytes: number | null;
            /** Quota Files */
            quota_files: number | null;
            right: components["schemas"]["Right"];
            /** Size Bytes */
            size_bytes: number;
            /** Unsatisfied Mission Count */
            unsatisfied_mission_count: number;
            /** Used Bytes */
            used_bytes: number;
            /** Used Files */
            used_files: number;
        };
        /**
         * ProjectRef
         * @description The id and name of a project.
         */
        ProjectRef: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string;
        };
        /**
         * ProjectSort
         * @description Orders of a list of projects; names by `COLLATE "C"`.
         * @enum {string}
         */
        ProjectSort: "name" | "-name" | "created" | "-created";
        /**
         * ProjectStorage
         * @description The size of a project. Files count with all their bytes, even if they share them with others.
         */
        ProjectStorage: {
            /** File Count */
            file_count: number;
            project: components["schemas"]["ProjectRef"];
            /** Quota Bytes */
            quota_bytes: number | null;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * ProjectUpdate
         * @description Changes of a project; omitted fields stay. Metadata fields are all replaced.
         *
         *     Everybody may read a public project, also without an account. `isolation` is the weakest class that its runs may
         *     have. Owners change these. A quota of null is no quota; admins set quotas.
         */
        ProjectUpdate: {
            /** Citation */
            citation?: string | null;
            /** Description */
            description?: string | null;
            /** Fields Yaml */
            fields_yaml?: string | null;
            /** Is Public */
            is_public?: boolean | null;
            isolation?: components["schemas"]["Isolation"] | null;
            /** Licence */
            licence?: string | null;
            metadata_fields?: components["schemas"]["MetadataFields"] | null;
            /** Name */
            name?: string | null;
            /** Quota Bytes */
            quota_bytes?: number | null;
            /** Quota Files */
            quota_files?: number | null;
        };
        /**
         * ProviderBegin
         * @description Start a sign-in with a provider: `POST /auth/providers/{name}`, or `…/link` to link it to your account.
         */
        ProviderBegin: {
            /**
             * Return To
             * @default /
             */
            return_to: string;
        };
        /**
         * ProviderBegun
         * @description The URL to which the browser goes next.
         */
        ProviderBegun: {
            /** Url */
            url: string;
        };
        /**
         * ProviderRef
         * @description An identity provider; `name` is its id in requests.
         */
        ProviderRef: {
            /** Name */
            name: string;
            /** Title */
            title: string;
        };
        /**
         * Rank
         * @description The place of a value in its row. Equal values share it.
         * @enum {string}
         */
        Rank: "best" | "worst";
        /**
         * ReadDepth
         * @description How content was read: by the file's own index, or every byte of it.
         * @enum {string}
         */
        ReadDepth: "summary" | "scan";
        /**
         * RecentMission
         * @description A mission with its last activity.
         */
        RecentMission: {
            /**
             * Active At
             * Format: date-time
             */
            active_at: string;
            /** File Count */
            file_count: number;
            mission: components["schemas"]["MissionRef"];
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * RecordingPreviewRead
         * @description The preview of a recording file, whose format the page on formats describes.
         *
         *     `url` is there if `state` is `ready`: GET the bytes from it before `expires_at`, with or without a Range header.
         *     `reason` says why it failed. Files with the same bytes share one preview.
         */
        RecordingPreviewRead: {
            /** Expires At */
            expires_at?: string | null;
            /**
             * File Id
             * Format: uuid
             */
            file_id: string;
            /** Made At */
            made_at?: string | null;
            /** Reason */
            reason?: string | null;
            /** Size Bytes */
            size_bytes?: number | null;
            state: components["schemas"]["RecordingPreviewState"];
            /** Url */
            url?: string | null;
            /** Version */
            version?: number | null;
        };
        /**
         * RecordingPreviewState
         * @description State of the preview of a file.
         * @enum {string}
         */
        RecordingPreviewState: "none" | "making" | "ready" | "failed" | "deleted";
        /**
         * RecordingRead
         * @description A recording of one or more files. `missing` are files that its metadata lists and the mission does not have.
         *
         *     `content` is of all files together: `recovered` if only a part can be read. `problems` are those of the recording;
         *     each file has its own. `is_derived`: runs made its files, so it is in no sum of what was recorded.
         */
        RecordingRead: {
            content: components["schemas"]["ContentState"];
            /** Content Reason */
            content_reason: string | null;
            /** End Ns */
            end_ns: number | null;
            /** File Ids */
            file_ids: string[];
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /**
             * Is Derived
             * @default false
             */
            is_derived: boolean;
            /** Kind */
            kind: string;
            lost: components["schemas"]["FileLoss"] | null;
            /** Message Count */
            message_count: number | null;
            /** Missing */
            missing: string[];
            mission: components["schemas"]["MissionRef"];
            /** Name */
            name: string;
            /** Paths */
            paths: string[];
            /** Problems */
            problems: components["schemas"]["FileProblem"][];
            /** Size Bytes */
            size_bytes: number;
            /** Start Ns */
            start_ns: number | null;
            /** Unlisted */
            unlisted: string[];
        };
        /**
         * RecordingRef
         * @description The id and name of a recording.
         */
        RecordingRef: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string;
        };
        /**
         * RecoveryCodes
         * @description Recovery codes for a lost device: each is valid once, and they cannot be shown again.
         */
        RecoveryCodes: {
            /** Codes */
            codes: string[];
        };
        /**
         * Report
         * @description The report of a run. `metadata` is a proposal; a person accepts or ignores it.
         *
         *     `verdict` is what the run concludes; a failed check or an error among the findings makes it worse, never better.
         */
        Report: {
            /**
             * Checks
             * @default []
             */
            checks: components["schemas"]["Check"][];
            /**
             * Findings
             * @default []
             */
            findings: components["schemas"]["Finding"][];
            /**
             * Metadata
             * @default {}
             */
            metadata: {
                [key: string]: components["schemas"]["JsonValue"];
            };
            /**
             * Metrics
             * @default []
             */
            metrics: components["schemas"]["Metric"][];
            /**
             * Mission Files
             * @default []
             */
            mission_files: components["schemas"]["MissionFile"][];
            /**
             * Previews
             * @default []
             */
            previews: components["schemas"]["Preview"][];
            /** Verdict */
            verdict?: ("good" | "warnings" | "bad") | null;
        };
        /**
         * Resources
         * @description The limits of a run, which its runner reserves. In manifests also as `memory: 4GB`, `time: 30m`.
         *
         *     `disk_bytes` is for `/out` and `/tmp` together.
         */
        Resources: {
            /**
             * Cores
             * @default 1
             */
            cores: number;
            /**
             * Disk Bytes
             * @default 10000000000
             */
            disk_bytes: number;
            /**
             * Gpus
             * @default 0
             */
            gpus: number;
            /**
             * Labels
             * @default []
             */
            labels: string[];
            /**
             * Memory Bytes
             * @default 2000000000
             */
            memory_bytes: number;
            /**
             * Time S
             * @default 3600
             */
            time_s: number;
        };
        /**
         * RetriedJobs
         * @description The number of failed jobs that were requeued.
         */
        RetriedJobs: {
            /** Count */
            count: number;
        };
        /**
         * RetryingJob
         * @description A job that failed and waits for another attempt. `error` is of the last one.
         */
        RetryingJob: {
            /** Attempts */
            attempts: number;
            /** Error */
            error: string | null;
            /** Id */
            id: number;
            /** Kind */
            kind: string;
            /** Next Attempt At */
            next_attempt_at: string | null;
            /** Ref */
            ref: string | null;
        };
        /**
         * Right
         * @description Rights on a project or a mission. Each right includes those before it; compare by `level`.
         * @enum {string}
         */
        Right: "READ" | "CREATE" | "WRITE" | "DELETE";
        /**
         * RunAssignment
         * @description A run that is leased to a runner.
         *
         *     `image_digest` is what the image's name was first resolved to, by any runner: only that image may be run.
         *     `token` is the run's own and valid while the run lasts; null where the network is `none`. `traceparent` (W3C Trace
         *     Context) is the trace that the run belongs to, if the server exports traces.
         */
        RunAssignment: {
            action: components["schemas"]["ActionRef"];
            /** Attempt */
            attempt: number;
            /**
             * @default {
             *       "exclusive": false,
             *       "options": {}
             *     }
             */
            cluster: components["schemas"]["ClusterRequest"];
            /** Command */
            command: string[];
            /** Dependencies */
            dependencies: string[];
            /** Image */
            image: string | null;
            /** Image Digest */
            image_digest: string | null;
            /** Inputs */
            inputs: components["schemas"]["AssignedInput"][];
            /** Lease S */
            lease_s: number;
            /** Lock */
            lock?: string | null;
            /**
             * Mission Id
             * Format: uuid
             */
            mission_id: string;
            network: components["schemas"]["Network"];
            /** Parameters */
            parameters: {
                [key: string]: boolean | number | string;
            };
            /**
             * Project Id
             * Format: uuid
             */
            project_id: string;
            /** Requires Python */
            requires_python?: string | null;
            resources: components["schemas"]["Resources"];
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
            /** Script */
            script: string | null;
            /** Token */
            token: string | null;
            /** Traceparent */
            traceparent?: string | null;
        };
        /**
         * RunAttempt
         * @description A run, and the attempt of the runner's lease.
         */
        RunAttempt: {
            /** Attempt */
            attempt: number;
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
        };
        /**
         * RunChecks
         * @description The `checks.yaml` of the project as it was at the launch. `version` is its number, `sha256` that of the text.
         */
        RunChecks: {
            /** Sha256 */
            sha256: string;
            /** Text */
            text: string;
            /** Version */
            version: number;
        };
        /**
         * RunContext
         * @description The content of `/in/mission.json`: the mission, the input files with their topics, the parameters.
         *
         *     `run_id` is null for a local run. `topics` belong to the files, `recordings` to the mission. Metadata that the
         *     action declares as inputs have their values at the launch; with `checks` or `reference`, all have. `checks` and
         *     `reference` are null unless the action declares to read them, and where there is none. `reference` is the name of
         *     the trajectory with which estimates are compared: of the mission's metadata, or else of the `checks.yaml`.
         */
        RunContext: {
            action: components["schemas"]["ActionRef"];
            cause: components["schemas"]["Cause"];
            checks?: components["schemas"]["RunChecks"] | null;
            /**
             * Contract
             * @default 1
             * @constant
             */
            contract: 1;
            /** Files */
            files: components["schemas"]["FileRead"][];
            mission: components["schemas"]["MissionRead"];
            /** Parameters */
            parameters: {
                [key: string]: boolean | number | string;
            };
            /** Recordings */
            recordings: components["schemas"]["RecordingRead"][];
            /** Reference */
            reference?: string | null;
            /** Run Id */
            run_id: string | null;
            /** Topics */
            topics: components["schemas"]["TopicRead"][];
        };
        /**
         * RunContexts
         * @description The contents of `/in/mission.json`, in the order requested; null for a run that the runner does not have.
         */
        RunContexts: {
            /** Contexts */
            contexts: (components["schemas"]["RunContext"] | null)[];
        };
        /**
         * RunCreated
         * @description A run that was created; one that reuses results has already ended.
         */
        RunCreated: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            outcome: "created";
            run: components["schemas"]["RunRead"];
        };
        /**
         * RunDetail
         * @description A run with its details. `problems` name the results that could not be stored.
         *
         *     `metadata` is what the run proposes for the mission. There are at most 720 `samples`. `packages` are the versions in
         *     the lock of its definition, such as `evo==1.38.1`; the lock itself is left out, since it is large.
         */
        RunDetail: {
            action: components["schemas"]["ActionRef"];
            /** Artifact Count */
            artifact_count: number;
            /** Attempt */
            attempt: number;
            /** Cancel Requested At */
            cancel_requested_at: string | null;
            cause: components["schemas"]["Cause"];
            /**
             * Check Counts
             * @default {}
             */
            check_counts: {
                [key: string]: number;
            };
            /** Claimed At */
            claimed_at: string | null;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            definition: components["schemas"]["ActionDefinition"];
            /** Ended At */
            ended_at: string | null;
            /** Exit Code */
            exit_code: number | null;
            /** Finding Counts */
            finding_counts: {
                [key: string]: number;
            };
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Image Digest */
            image_digest: string | null;
            /** Input Bytes */
            input_bytes: number;
            /** Input Count */
            input_count: number;
            /**
             * Is Recorded
             * @default false
             */
            is_recorded: boolean;
            isolation?: components["schemas"]["Isolation"] | null;
            /** May Cancel */
            may_cancel: boolean;
            /** Message */
            message: string;
            /** Metadata */
            metadata: {
                [key: string]: components["schemas"]["JsonValue"];
            };
            /** Metric Count */
            metric_count: number;
            /**
             * Metrics
             * @default []
             */
            metrics: components["schemas"]["Metric"][];
            mission: components["schemas"]["MissionRef"];
            network: components["schemas"]["Network"];
            /**
             * Packages
             * @default []
             */
            packages: string[];
            /** Parameters */
            parameters: {
                [key: string]: boolean | number | string;
            };
            placement?: components["schemas"]["RunPlacement"] | null;
            /** Previews */
            previews: components["schemas"]["Preview"][];
            /** @default normal */
            priority: components["schemas"]["RunPriority"];
            /** Problems */
            problems: string[];
            progress: components["schemas"]["Progress"] | null;
            reason: components["schemas"]["EndReason"] | null;
            /** Reuses Id */
            reuses_id: string | null;
            /** Runner */
            runner: string | null;
            /** Samples */
            samples: components["schemas"]["UsageSample"][];
            /** Started At */
            started_at: string | null;
            state: components["schemas"]["RunState"];
            usage: components["schemas"]["Usage"] | null;
            /** Verdict */
            verdict?: ("good" | "warnings" | "bad") | null;
            /**
             * Version Id
             * Format: uuid
             */
            version_id: string;
            /** Waits For */
            waits_for: string | null;
        };
        /**
         * RunEnd
         * @description The end of one of several runs.
         */
        RunEnd: {
            finish: components["schemas"]["RunFinish"];
            /**
             * Run Id
             * Format: uuid
             */
            run_id: string;
        };
        /**
         * RunEnds
         * @description The ends of several runs of a runner.
         */
        RunEnds: {
            /** Ends */
            ends: components["schemas"]["RunEnd"][];
        };
        /**
         * RunEndsRecorded
         * @description The final states of runs, in the order sent; null for a run that the runner does not have by this attempt.
         */
        RunEndsRecorded: {
            /** States */
            states: (components["schemas"]["RunState"] | null)[];
        };
        /**
         * RunFinish
         * @description How a run ended, sent once its artifacts are uploaded. Idempotent.
         *
         *     `log`: the complete log, if it is small and was not uploaded.
         */
        RunFinish: {
            /** Attempt */
            attempt: number;
            /** Exit Code */
            exit_code?: number | null;
            /** Image Digest */
            image_digest?: string | null;
            /** Log */
            log?: string | null;
            /** Message */
            message: string;
            placement?: components["schemas"]["RunPlacement"] | null;
            /**
             * Problems
             * @default []
             */
            problems: string[];
            reason: components["schemas"]["EndReason"];
            /**
             * @default {
             *       "checks": [],
             *       "findings": [],
             *       "metadata": {},
             *       "metrics": [],
             *       "mission_files": [],
             *       "previews": []
             *     }
             */
            report: components["schemas"]["Report"];
            /**
             * Samples
             * @default []
             */
            samples: components["schemas"]["UsageSample"][];
            usage?: components["schemas"]["Usage"] | null;
        };
        /**
         * RunFinished
         * @description The final state of a run.
         */
        RunFinished: {
            state: components["schemas"]["RunState"];
        };
        /**
         * RunInput
         * @description An input of a run, as it was at launch. `file_id` is null where the file no longer exists.
         */
        RunInput: {
            /** File Id */
            file_id: string | null;
            /** Path */
            path: string;
            /** Sha256 */
            sha256: string;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * RunnerRead
         * @description A runner, as admins see it. `token` is null until it registers again after an update of the server.
         *
         *     `lease_s` is how long its runs may go on without news from it.
         */
        RunnerRead: {
            abilities: components["schemas"]["ExecutorAbilities"];
            /** Active Runs */
            active_runs: number;
            capacity: components["schemas"]["Capacity"];
            /** Default Image */
            default_image: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Alive */
            is_alive: boolean;
            /** Labels */
            labels: string[];
            /**
             * Last Seen At
             * Format: date-time
             */
            last_seen_at: string;
            /**
             * Lease S
             * @default 60
             */
            lease_s: number;
            /** Name */
            name: string;
            token?: components["schemas"]["RunnerToken"] | null;
            /** Version */
            version: string;
        };
        /**
         * RunnerRegistration
         * @description A runner's description of itself, sent at each start. `id` is permanent, and stored in its state directory.
         *
         *     `default_image` is the digest of the image that it runs scripts on; null where it has none. `lease_s` is how long
         *     its runs may go on without news from it. `capacity` is the largest that a single run may ask for.
         */
        RunnerRegistration: {
            abilities: components["schemas"]["ExecutorAbilities"];
            capacity: components["schemas"]["Capacity"];
            /** Default Image */
            default_image?: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /**
             * Labels
             * @default []
             */
            labels: string[];
            /**
             * Lease S
             * @default 60
             */
            lease_s: number;
            /** Name */
            name: string;
            /** Version */
            version: string;
        };
        /**
         * RunnerToken
         * @description The token of a runner and its limits: runs of these projects that require one of these labels; null: any.
         */
        RunnerToken: {
            /** Expires At */
            expires_at: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Labels */
            labels: string[] | null;
            /** Name */
            name: string;
            /** Projects */
            projects: components["schemas"]["ProjectRef"][] | null;
        };
        /**
         * RunPlacement
         * @description Where a run is on its cluster or machine, and what that measured.
         *
         *     `job_id` is the cluster's own, such as `4711` or `4711_3` of Slurm. `queued_s` is how long its job waited there.
         *     `gpus` are the devices that it has, by id. `cpu_s` and `peak_memory_bytes` are from the accounting of the cluster.
         *     `requeues` is how often the cluster started it again.
         */
        RunPlacement: {
            /** Cpu S */
            cpu_s?: number | null;
            /**
             * Gpus
             * @default []
             */
            gpus: string[];
            /** Job Id */
            job_id?: string | null;
            /** Node */
            node?: string | null;
            /** Peak Memory Bytes */
            peak_memory_bytes?: number | null;
            /** Queued S */
            queued_s?: number | null;
            /**
             * Requeues
             * @default 0
             */
            requeues: number;
        };
        /**
         * RunPriority
         * @description Which queued runs start first; among those of one priority, projects take turns, and people within a project.
         *
         *     `high` requires DELETE on the mission. A run of priority `low` that waited for an hour counts as `normal`.
         * @enum {string}
         */
        RunPriority: "low" | "normal" | "high";
        /**
         * RunRead
         * @description A run of an action on a mission.
         *
         *     `reason`, `message` and `exit_code` describe how it ended, `waits_for` why it is still queued. `image_digest` is of
         *     the image that was run. `reuses_id` is the earlier run whose results this run reuses; it has none of its own.
         *     `verdict` is the worst of what its report says: its verdict, checks and findings. Null where it is not `done`, and
         *     where it judged nothing. `metrics` are the first reported ones, those of the run before those of single files; empty
         *     in a lineage. `isolation` is the class that its runner gave it; null before a runner has it, and where that was not
         *     recorded yet. `placement` is null before its runner reports one. `is_recorded`: it was executed elsewhere, and
         *     recorded with its results. `may_cancel`: the caller may cancel it, and it has not ended.
         */
        RunRead: {
            action: components["schemas"]["ActionRef"];
            /** Artifact Count */
            artifact_count: number;
            /** Attempt */
            attempt: number;
            /** Cancel Requested At */
            cancel_requested_at: string | null;
            cause: components["schemas"]["Cause"];
            /**
             * Check Counts
             * @default {}
             */
            check_counts: {
                [key: string]: number;
            };
            /** Claimed At */
            claimed_at: string | null;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Ended At */
            ended_at: string | null;
            /** Exit Code */
            exit_code: number | null;
            /** Finding Counts */
            finding_counts: {
                [key: string]: number;
            };
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Image Digest */
            image_digest: string | null;
            /** Input Bytes */
            input_bytes: number;
            /** Input Count */
            input_count: number;
            /**
             * Is Recorded
             * @default false
             */
            is_recorded: boolean;
            isolation?: components["schemas"]["Isolation"] | null;
            /** May Cancel */
            may_cancel: boolean;
            /** Message */
            message: string;
            /** Metric Count */
            metric_count: number;
            /**
             * Metrics
             * @default []
             */
            metrics: components["schemas"]["Metric"][];
            mission: components["schemas"]["MissionRef"];
            network: components["schemas"]["Network"];
            /** Parameters */
            parameters: {
                [key: string]: boolean | number | string;
            };
            placement?: components["schemas"]["RunPlacement"] | null;
            /** @default normal */
            priority: components["schemas"]["RunPriority"];
            progress: components["schemas"]["Progress"] | null;
            reason: components["schemas"]["EndReason"] | null;
            /** Reuses Id */
            reuses_id: string | null;
            /** Runner */
            runner: string | null;
            /** Started At */
            started_at: string | null;
            state: components["schemas"]["RunState"];
            usage: components["schemas"]["Usage"] | null;
            /** Verdict */
            verdict?: ("good" | "warnings" | "bad") | null;
            /**
             * Version Id
             * Format: uuid
             */
            version_id: string;
            /** Waits For */
            waits_for: string | null;
        };
        /**
         * RunRecord
         * @description A run that was executed elsewhere, such as by Snakemake or a job of a cluster, with its results.
         *
         *     `script` is the text that was executed, for people to read. `inputs` and `outputs` are paths of files of the
         *     mission; the caller has uploaded the outputs, which become files that the run made. Recording the same again, with
         *     the same bytes, returns the same run.
         */
        RunRecord: {
            /** Duration S */
            duration_s?: number | null;
            /** Inputs */
            inputs: string[];
            /**
             * Mission Id
             * Format: uuid
             */
            mission_id: string;
            /** Name */
            name: string;
            /**
             * Outputs
             * @default []
             */
            outputs: string[];
            /**
             * Parameters
             * @default {}
             */
            parameters: {
                [key: string]: boolean | number | string;
            };
            /**
             * @default {
             *       "checks": [],
             *       "findings": [],
             *       "metadata": {},
             *       "metrics": [],
             *       "mission_files": [],
             *       "previews": []
             *     }
             */
            report: components["schemas"]["Report"];
            /** Script */
            script: string;
        };
        /**
         * RunRefused
         * @description Why no run was created on a mission; runs on the other missions were.
         */
        RunRefused: {
            /**
             * Mission Id
             * Format: uuid
             */
            mission_id: string;
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            outcome: "refused";
            problem: components["schemas"]["ProblemDocument"];
        };
        /**
         * RunsCreate
         * @description An action to run on each of some missions: a published one by id, or an unpublished definition.
         *
         *     Without `version`, the latest version runs. Results of an earlier successful run with the same version, image,
         *     parameters and inputs (files, and the metadata, checks and reference that it declares) are reused unless `force`.
         */
        RunsCreate: {
            /** Action Id */
            action_id?: string | null;
            definition?: components["schemas"]["ActionDefinition"] | null;
            /**
             * Force
             * @default false
             */
            force: boolean;
            /** Mission Ids */
            mission_ids: string[];
            /**
             * Parameters
             * @default {}
             */
            parameters: {
                [key: string]: boolean | number | string;
            };
            /** @default normal */
            priority: components["schemas"]["RunPriority"];
            /** Version */
            version?: number | null;
        };
        /**
         * RunsCreated
         * @description One outcome per mission, in the requested order.
         */
        RunsCreated: {
            /** Items */
            items: (components["schemas"]["RunCreated"] | components["schemas"]["RunRefused"])[];
        };
        /**
         * RunState
         * @description The state of a run. `preparing` fetches image and inputs, `collecting` uploads results; three are final.
         * @enum {string}
         */
        RunState: "queued" | "preparing" | "running" | "collecting" | "done" | "failed" | "cancelled";
        /**
         * RunTrigger
         * @description When an action runs: once a mission is marked complete, or once its files have not changed for some time.
         * @enum {string}
         */
        RunTrigger: "complete" | "idle";
        /**
         * Scope
         * @description Scopes of a token, within the rights of its person.
         *
         *     `read`: view and download. `upload`: create missions and upload files, seeing only names. `write`: change and
         *     delete, and also `read` and `upload`. `run`: start and cancel runs. `admin`: everything, including granting rights
         *     and admin rights.
         * @enum {string}
         */
        Scope: "read" | "upload" | "write" | "run" | "admin";
        /**
         * ScrubRead
         * @description A comparison of the objects in the store with the database.
         *
         *     `lost` and `corrupt`: newly detected blobs; `recovered`: lost ones whose objects are back and are being verified;
         *     `unknown`: objects that the database does not have. `aborted_reason`: why it marked nothing, or not all.
         *     Until `ended_at`, the numbers cover what was compared so far.
         */
        ScrubRead: {
            /** Aborted Reason */
            aborted_reason: string | null;
            /** Compared */
            compared: number;
            /** Compared Bytes */
            compared_bytes: number;
            /** Corrupt */
            corrupt: number;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Ended At */
            ended_at: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Lost */
            lost: number;
            /** Recovered */
            recovered: number;
            /**
             * Seen At
             * Format: date-time
             */
            seen_at: string;
            /** Started At */
            started_at: string | null;
            /** Unknown */
            unknown: number;
        };
        /**
         * ScrubRequest
         * @description A scrub to start. `accept_losses`: the admin has checked that missing objects are really gone.
         */
        ScrubRequest: {
            /**
             * Accept Losses
             * @default false
             */
            accept_losses: boolean;
        };
        /**
         * ScrubState
         * @description The last scrub, if any, and the blobs by state; lost and corrupt ones count if something refers to them.
         *
         *     `oldest_verification_at` is the oldest `verified_at` of all blobs; they are verified again after `again_after_days`.
         */
        ScrubState: {
            /** Again After Days */
            again_after_days: number;
            /** Blobs */
            blobs: components["schemas"]["StateAmount"][];
            /** Every Hours */
            every_hours: number;
            last: components["schemas"]["ScrubRead"] | null;
            /** Oldest Verification At */
            oldest_verification_at: string | null;
        };
        /**
         * SearchRead
         * @description The first missions, files and topics that match a query, and their numbers.
         *
         *     `query` is the normalized text; `filter` its meaning. Missions match themselves or by their files. The lists
         *     continue at `/missions` and `/files` with the same `query` and `sort=-start`. `is_exact` is false if very many files
         *     match: all numbers are then estimates with two digits, and the topics those of sampled files.
         */
        SearchRead: {
            files: components["schemas"]["Page_FileRead_"];
            filter: components["schemas"]["FileFilter"];
            /**
             * Is Exact
             * @default true
             */
            is_exact: boolean;
            missions: components["schemas"]["Page_MissionRead_"];
            /** Query */
            query: string;
            topics: components["schemas"]["Page_TopicFound_"];
        };
        /**
         * ServiceRead
         * @description A server: `GET /api/v1/service`. `name` is the lab's; `person` is the caller, if they have an account.
         *
         *     Bytes are sent to and fetched from `store_url`; `store_origin` is its origin in browsers. `token_days_max` 0: tokens
         *     without an end are allowed. `weakest_isolation`: the weakest that owners of projects may allow for runs.
         *     `map_tiles`: where pages get the tiles of maps, if that is set.
         */
        ServiceRead: {
            /** Checksum */
            checksum: string;
            /** Has Local Accounts */
            has_local_accounts: boolean;
            map_tiles?: components["schemas"]["MapTiles"] | null;
            /** Name */
            name: string;
            person: components["schemas"]["PersonRef"] | null;
            /** Public Url */
            public_url: string;
            /** Store Origin */
            store_origin: string;
            /** Store Url */
            store_url: string;
            /**
             * Token Days Default
             * @default 0
             */
            token_days_default: number;
            /**
             * Token Days Max
             * @default 0
             */
            token_days_max: number;
            /** Version */
            version: string;
            /** Viewers */
            viewers: components["schemas"]["ViewerRead"][];
            /** @default container */
            weakest_isolation: components["schemas"]["Isolation"];
        };
        /**
         * SessionRead
         * @description A browser in which you are signed in: `GET /me/sessions`; `DELETE /me/sessions/{id}` signs it out.
         */
        SessionRead: {
            /** Address */
            address: string | null;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Current */
            is_current: boolean;
            /**
             * Last Used At
             * Format: date-time
             */
            last_used_at: string;
            /** Method */
            method: string;
            /** User Agent */
            user_agent: string | null;
        };
        /**
         * SettingRead
         * @description A setting in force. `is_set`: by the environment, otherwise the default. Secrets have no value here.
         */
        SettingRead: {
            /** Is Secret */
            is_secret: boolean;
            /** Is Set */
            is_set: boolean;
            /** Name */
            name: string;
            /** Value */
            value: unknown;
        };
        /**
         * Severity
         * @description The severity of a finding.
         * @enum {string}
         */
        Severity: "info" | "warning" | "error";
        /**
         * ShareCreate
         * @description A link to create: to files of a mission, or with `file_ids` null to everything in it, now and later.
         */
        ShareCreate: {
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /** File Ids */
            file_ids?: string[] | null;
            /** Name */
            name: string;
        };
        /**
         * SharedRead
         * @description Current content of a share link.
         */
        SharedRead: {
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /** File Count */
            file_count: number;
            /** Is Whole Mission */
            is_whole_mission: boolean;
            mission: components["schemas"]["MissionRef"];
            /** Name */
            name: string;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * ShareMade
         * @description A new link with its secret, which cannot be shown again. `url` contains the secret.
         */
        ShareMade: {
            /** Secret */
            secret: string;
            share: components["schemas"]["ShareRead"];
            /** Url */
            url: string;
        };
        /**
         * ShareRead
         * @description A link without its secret; `prefix` is the beginning of the secret.
         *
         *     `file_count` is null for a link to all files of a mission. Downloads count each file whose URL was requested.
         */
        ShareRead: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"];
            /** Download Bytes */
            download_bytes: number;
            /** Download Count */
            download_count: number;
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /** File Count */
            file_count: number | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Last Used At */
            last_used_at: string | null;
            mission: components["schemas"]["MissionRef"];
            /** Name */
            name: string;
            /** Prefix */
            prefix: string;
            /** Revoked At */
            revoked_at: string | null;
        };
        /**
         * SignedIn
         * @description A new token, shown only once, and its person.
         */
        SignedIn: {
            /** Expires At */
            expires_at: string | null;
            person: components["schemas"]["PersonRef"];
            /** Token */
            token: string;
        };
        /**
         * SignedPart
         * @description PUT the part's bytes to `url` with exactly these headers, before `expires_at`.
         */
        SignedPart: {
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /** Headers */
            headers: {
                [key: string]: string;
            };
            /** Number */
            number: number;
            /**
             * Upload Id
             * Format: uuid
             */
            upload_id: string;
            /** Url */
            url: string;
        };
        /**
         * SignedParts
         * @description Signed parts, in the order of the request, which also renewed the leases of their uploads.
         */
        SignedParts: {
            /** Items */
            items: components["schemas"]["SignedPart"][];
        };
        /**
         * SignInMethods
         * @description The sign-in methods of a server: `GET /auth/methods`. `bootstrap`: it has no admin yet.
         */
        SignInMethods: {
            /** Bootstrap */
            bootstrap: boolean;
            /** Password */
            password: boolean;
            /** Providers */
            providers: components["schemas"]["ProviderRef"][];
        };
        /**
         * StateAmount
         * @description Number and bytes of the blobs or uploads in a state.
         */
        StateAmount: {
            /** Count */
            count: number;
            /** Size Bytes */
            size_bytes: number;
            /** State */
            state: string;
        };
        /**
         * StatsRead
         * @description Statistics by `by`: `project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`.
         */
        StatsRead: {
            /** By */
            by: string;
            /** Rows */
            rows: components["schemas"]["StatsRow"][];
            total: components["schemas"]["StatsRow"];
        };
        /**
         * StatsRow
         * @description Totals of one group, without the trash. `duration_ns` is the sum of the spans of the recordings.
         *
         *     Grouped by topic or message type, a recording counts in each of its groups, and `messages` are those of the group.
         */
        StatsRow: {
            /** Duration Ns */
            duration_ns: number;
            /** Files */
            files: number;
            /** Group */
            group: string | null;
            /** Messages */
            messages: number;
            /** Missions */
            missions: number;
            /** Recordings */
            recordings: number;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * StatusItem
         * @description Something that an admin should attend to. `remedy` says what to do; empty if the message does.
         */
        StatusItem: {
            /** Message */
            message: string;
            /** Remedy */
            remedy: string;
            severity: components["schemas"]["StatusSeverity"];
            /** Subject */
            subject: string;
        };
        /**
         * StatusSeverity
         * @description `problem`: something does not work, or data are damaged; `warning`: it will not work for long, or is late.
         * @enum {string}
         */
        StatusSeverity: "problem" | "warning";
        /**
         * StoredPart
         * @description A part that the store has.
         */
        StoredPart: {
            /** Etag */
            etag: string;
            /** Number */
            number: number;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * StoreUse
         * @description The bytes in the store, and the free space if its disk is on the server's machine or its capacity is set.
         */
        StoreUse: {
            /** Disk Bytes */
            disk_bytes: number | null;
            /** Free Bytes */
            free_bytes: number | null;
            /** Used Bytes */
            used_bytes: number;
        };
        /**
         * TextFormat
         * @description A format in which a table can be written.
         * @enum {string}
         */
        TextFormat: "csv" | "markdown" | "latex";
        /**
         * ThumbnailsRequest
         * @description The files of a list.
         */
        ThumbnailsRequest: {
            /** File Ids */
            file_ids: string[];
        };
        /**
         * TimeAxis
         * @description The bins that several densities share: `bins` of `bin_ns` each, the first from `start_ns` on.
         */
        TimeAxis: {
            /** Bin Ns */
            bin_ns: number;
            /** Bins */
            bins: number;
            /** Start Ns */
            start_ns: number;
        };
        /**
         * TimelineFile
         * @description When a file was recorded; `start_ns` and `end_ns` are null if it has no times, or was not read yet.
         *
         *     `is_derived`: a run made it from other files.
         */
        TimelineFile: {
            content: components["schemas"]["ContentState"];
            /** End Ns */
            end_ns: number | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /**
             * Is Derived
             * @default false
             */
            is_derived: boolean;
            /** Path */
            path: string;
            /** Recording Id */
            recording_id: string | null;
            /** Size Bytes */
            size_bytes: number;
            /** Start Ns */
            start_ns: number | null;
            state: components["schemas"]["BlobState"];
        };
        /**
         * TokenCreate
         * @description A token to create. Default `scopes` depend on its kind; without limits it reaches everything its person may see.
         *
         *     A robot's token is limited to projects or missions and cannot have the scope admin. A runner's token is for one
         *     runner: `runner_id`, else the first one that uses it. With projects it gets only runs on these, with `runner_labels`
         *     only runs that require one of them. Without `expires_at`, the server's settings decide; some servers allow `no_end`.
         */
        TokenCreate: {
            /** Expires At */
            expires_at?: string | null;
            /** @default personal */
            kind: components["schemas"]["TokenKind"];
            /**
             * Mission Ids
             * @default []
             */
            mission_ids: string[];
            /** Name */
            name: string;
            /**
             * No End
             * @default false
             */
            no_end: boolean;
            /**
             * Project Ids
             * @default []
             */
            project_ids: string[];
            /** Runner Id */
            runner_id?: string | null;
            /** Runner Labels */
            runner_labels?: string[] | null;
            /** Scopes */
            scopes?: components["schemas"]["Scope"][] | null;
        };
        /**
         * TokenKind
         * @description Who uses a token: a person's script, a robot, a runner of actions, or a single run.
         * @enum {string}
         */
        TokenKind: "personal" | "robot" | "runner" | "run";
        /**
         * TokenLimit
         * @description A project or mission to which a token is limited. `name` is null if the caller may not see it.
         */
        TokenLimit: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string | null;
            /** Resource Type */
            resource_type: string;
        };
        /**
         * TokenMade
         * @description A new token with its secret, which cannot be shown again.
         */
        TokenMade: {
            /** Secret */
            secret: string;
            token: components["schemas"]["TokenRead"];
        };
        /**
         * TokenRead
         * @description A token without its secret; `prefix` is the beginning of the secret.
         *
         *     `limits` are null for an unlimited token, and empty if everything it was limited to was deleted. `last_used_at` is
         *     exact to a minute. `runner` is null until a runner uses the token.
         */
        TokenRead: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Expires At */
            expires_at: string | null;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            kind: components["schemas"]["TokenKind"];
            /** Last Used At */
            last_used_at: string | null;
            /** Limits */
            limits: components["schemas"]["TokenLimit"][] | null;
            /** Name */
            name: string;
            person: components["schemas"]["PersonRef"];
            /** Prefix */
            prefix: string;
            /** Revoked At */
            revoked_at: string | null;
            runner?: components["schemas"]["TokenRunner"] | null;
            /** Runner Labels */
            runner_labels?: string[] | null;
            /** Scopes */
            scopes: components["schemas"]["Scope"][];
        };
        /**
         * TokenRunner
         * @description The runner to which a token is bound. `name` is null until the runner registers.
         */
        TokenRunner: {
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Name */
            name: string | null;
        };
        /**
         * TopicFound
         * @description A topic of one name and type, over all matching files. `message_count` is null if unknown.
         */
        TopicFound: {
            /** File Count */
            file_count: number;
            /** Message Count */
            message_count: number | null;
            /** Message Type */
            message_type: string | null;
            /** Name */
            name: string;
        };
        /**
         * TopicRead
         * @description One topic of one recording file. Times are log times in ns since 1970; `rate_hz` is (count - 1) / span.
         *
         *     `density` is null in lists of several files.
         */
        TopicRead: {
            /** Count */
            count: number | null;
            density?: components["schemas"]["Density"] | null;
            /**
             * File Id
             * Format: uuid
             */
            file_id: string;
            /** First Ns */
            first_ns: number | null;
            /** Head Gap Ns */
            head_gap_ns: number | null;
            /** Last Ns */
            last_ns: number | null;
            /** Longest Gap Ns */
            longest_gap_ns: number | null;
            /** Message Encoding */
            message_encoding: string | null;
            /** Message Type */
            message_type: string | null;
            /** Name */
            name: string;
            /** Out Of Order Count */
            out_of_order_count: number | null;
            /** Rate Hz */
            rate_hz: number | null;
            /** Schema Encoding */
            schema_encoding: string | null;
            /** Schema Name */
            schema_name: string | null;
            /** Stored Bytes */
            stored_bytes: number | null;
            /** Tail Gap Ns */
            tail_gap_ns: number | null;
        };
        /**
         * TotpConfirm
         * @description Confirm a second factor with one of its codes: `POST /me/totp/confirm`.
         */
        TotpConfirm: {
            /** Code */
            code: string;
        };
        /**
         * TotpEnrolment
         * @description A secret for an authenticator app: as text, `otpauth:` URL, and QR code (a `data:` URL).
         */
        TotpEnrolment: {
            /** Qr */
            qr: string;
            /** Secret */
            secret: string;
            /** Url */
            url: string;
        };
        /**
         * TotpRead
         * @description A confirmed second factor.
         */
        TotpRead: {
            /**
             * Enabled At
             * Format: date-time
             */
            enabled_at: string;
            /** Recovery Codes Left */
            recovery_codes_left: number;
        };
        /**
         * TrashRead
         * @description A deleted object. `location` is the project of a mission, or project and mission of a file.
         *
         *     Missions that were deleted with their project are restored with it, and not listed.
         */
        TrashRead: {
            /**
             * Deleted At
             * Format: date-time
             */
            deleted_at: string;
            deleted_by: components["schemas"]["PersonRef"];
            /** File Count */
            file_count: number;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Location */
            location: string;
            /** Name */
            name: string;
            /**
             * Purged After
             * Format: date-time
             */
            purged_after: string;
            resource_type: components["schemas"]["TrashResourceType"];
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * TrashResourceType
         * @description What can be in the trash.
         * @enum {string}
         */
        TrashResourceType: "project" | "mission" | "file";
        /**
         * TrendBucket
         * @description The number of missions by verdict that were recorded in one day or week (created, where nothing is recorded).
         */
        TrendBucket: {
            /**
             * Start
             * Format: date
             */
            start: string;
            /** Verdicts */
            verdicts: {
                [key: string]: number;
            };
        };
        /**
         * TrendStep
         * @description The width of the buckets of a trend. Weeks begin on Monday, in UTC.
         * @enum {string}
         */
        TrendStep: "day" | "week";
        /**
         * Undeclared
         * @description Treatment of metadata keys that no field declares.
         * @enum {string}
         */
        Undeclared: "accept" | "refuse";
        /**
         * UnfinishedUpload
         * @description An unfinished upload. `sent_bytes` are in the store; null if it did not answer.
         *
         *     Until `expires_at`, uploading the same file again continues it.
         */
        UnfinishedUpload: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            mission: components["schemas"]["MissionRef"];
            /** Path */
            path: string;
            /** Sent Bytes */
            sent_bytes: number | null;
            /** Size Bytes */
            size_bytes: number;
        };
        /**
         * UploadBegin
         * @description Files to upload into one mission.
         */
        UploadBegin: {
            /** Files */
            files: components["schemas"]["UploadFile"][];
        };
        /**
         * UploadDecisions
         * @description One decision per file, in the order of the request.
         */
        UploadDecisions: {
            /** Items */
            items: (components["schemas"]["AlreadyPresent"] | components["schemas"]["Deduplicated"] | components["schemas"]["HashRequired"] | components["schemas"]["UploadRequired"] | components["schemas"]["UploadRefused"])[];
        };
        /**
         * UploadFile
         * @description One file to upload. The hashes are lower-case hex, and may be left out if they are not known yet.
         *
         *     Clients announce small files with both hashes: then one response decides about most of them, and contains the URL
         *     of a file's only part.
         *     `upload_id` resumes an earlier upload of the same path and size, or starts one with that id. Repeating a request
         *     with the same id therefore returns the upload that the first request created.
         */
        UploadFile: {
            /** Crc64Nvme */
            crc64nvme?: string | null;
            /** Path */
            path: string;
            /** Sha256 */
            sha256?: string | null;
            /** Size Bytes */
            size_bytes: number;
            /** Upload Id */
            upload_id?: string | null;
        };
        /**
         * UploadFinish
         * @description An upload whose parts are all sent, and the hashes of the file.
         */
        UploadFinish: {
            /** Crc64Nvme */
            crc64nvme: string;
            /** Sha256 */
            sha256: string;
            /**
             * Upload Id
             * Format: uuid
             */
            upload_id: string;
        };
        /**
         * UploadOutcomes
         * @description One outcome per upload, in the order of the request.
         */
        UploadOutcomes: {
            /** Items */
            items: (components["schemas"]["Completed"] | components["schemas"]["NotCompleted"])[];
        };
        /**
         * UploadRead
         * @description An upload. `parts` are those that the store has, in order.
         */
        UploadRead: {
            checksum: components["schemas"]["ChecksumKind"];
            /**
             * Expires At
             * Format: date-time
             */
            expires_at: string;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /**
             * Lease Ends At
             * Format: date-time
             */
            lease_ends_at: string;
            /**
             * Mission Id
             * Format: uuid
             */
            mission_id: string;
            /** Part Size Bytes */
            part_size_bytes: number;
            /**
             * Parts
             * @default []
             */
            parts: components["schemas"]["StoredPart"][];
            /** Path */
            path: string;
            /** Size Bytes */
            size_bytes: number;
            state: components["schemas"]["UploadState"];
        };
        /**
         * UploadRefused
         * @description This file cannot be uploaded; the others can.
         */
        UploadRefused: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            decision: "refused";
            /** Path */
            path: string;
            problem: components["schemas"]["ProblemDocument"];
        };
        /**
         * UploadRequired
         * @description Send the parts that `upload` does not list.
         *
         *     `part`: the URL of the file's only part, signed for the announced checksum. Otherwise, request URLs of the parts.
         */
        UploadRequired: {
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            decision: "upload";
            part?: components["schemas"]["SignedPart"] | null;
            upload: components["schemas"]["UploadRead"];
        };
        /**
         * UploadsComplete
         * @description Uploads to finish.
         */
        UploadsComplete: {
            /** Uploads */
            uploads: components["schemas"]["UploadFinish"][];
        };
        /**
         * UploadState
         * @description `open` accepts parts, the server finishes one that is `completing`; the others are final.
         * @enum {string}
         */
        UploadState: "open" | "completing" | "done" | "aborted" | "expired";
        /**
         * Usage
         * @description Resource usage of a run. `memory_bytes` is the current value, `peak_memory_bytes` the maximum.
         */
        Usage: {
            /** Cpu S */
            cpu_s: number;
            /** Memory Bytes */
            memory_bytes: number;
            /** Peak Memory Bytes */
            peak_memory_bytes: number;
            /** Read Bytes */
            read_bytes: number;
            /** Written Bytes */
            written_bytes: number;
        };
        /**
         * UsageSample
         * @description Resource usage of a run `at_s` seconds after its start.
         */
        UsageSample: {
            /** At S */
            at_s: number;
            usage: components["schemas"]["Usage"];
        };
        /**
         * Verdict
         * @description What the checks of a mission amount to.
         *
         *     outdated: files, the file of checks, or the version of an action are newer than the results. running: checks are
         *     being made. unchecked: there are none, or some are still to be made and none has failed.
         * @enum {string}
         */
        Verdict: "good" | "warnings" | "bad" | "outdated" | "running" | "unchecked";
        /**
         * VersionCreate
         * @description A further version of an action; the name is unchanged.
         */
        VersionCreate: {
            definition: components["schemas"]["ActionDefinition"];
        };
        /**
         * ViewerLayoutCreate
         * @description A layout to add to a project. A personal one is visible to its creator only.
         *
         *     `panels` are texts as the addresses of the viewer have them. Instead of a recording, each names a place among the
         *     recordings that have the topic, from 1 on: `plot:1@/imu,linear_acceleration.x`.
         */
        ViewerLayoutCreate: {
            /**
             * Is Shared
             * @default false
             */
            is_shared: boolean;
            /** Name */
            name: string;
            /** Panels */
            panels: string[];
        };
        /**
         * ViewerLayoutRead
         * @description A layout of the viewer. The viewer shows the default of a project where its address names no panels.
         *
         *     `created_by` is null for callers without an account. `etag` covers the edited fields: a change with an outdated one
         *     is refused.
         */
        ViewerLayoutRead: {
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            created_by: components["schemas"]["PersonRef"] | null;
            /** Etag */
            etag?: string;
            /**
             * Id
             * Format: uuid
             */
            id: string;
            /** Is Default */
            is_default: boolean;
            /** Is Shared */
            is_shared: boolean;
            /** Name */
            name: string;
            /** Panels */
            panels: string[];
            /**
             * Project Id
             * Format: uuid
             */
            project_id: string;
        };
        /**
         * ViewerLayoutUpdate
         * @description Changes of a layout; omitted fields stay. A project has one default: the one before ends.
         */
        ViewerLayoutUpdate: {
            /** Is Default */
            is_default?: boolean | null;
            /** Name */
            name?: string | null;
            /** Panels */
            panels?: string[] | null;
        };
        /**
         * ViewerRead
         * @description An external page that shows a recording; `{url}` in its `url` stands for the recording's, percent-encoded.
         */
        ViewerRead: {
            /** Name */
            name: string;
            /** Url */
            url: string;
        };
    };
    responses: never;
    parameters: never;
    requestBodies: never;
    headers: never;
    pathItems: never;
}
export type $defs = Record<string, never>;
export interface operations {
    list_actions: {
        parameters: {
            query?: {
                archived?: boolean | null;
                cursor?: string | null;
                limit?: number;
                name?: string | null;
                project_id?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_ActionRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_action: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ActionCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ActionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_action: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                action_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ActionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_action: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                action_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ActionUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ActionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_action_versions: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                action_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_ActionVersionRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    publish_action_version: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                action_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["VersionCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ActionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_action_version: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                action_id: string;
                number: number;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ActionVersionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_admin_health: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["AdminHealth"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_admin_jobs: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["AdminJobs"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    retry_job: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                job_id: number;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    retry_jobs: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RetriedJobs"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_admin_scrub: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ScrubState"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    begin_scrub: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ScrubRequest"];
            };
        };
        responses: {
            /** @description Successful Response */
            202: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ScrubRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_admin_settings: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["AdminSettings"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_admin_status: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["AdminStatus"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_admin_storage: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["AdminStorage"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_audit_events: {
        parameters: {
            query?: {
                as_admin?: boolean | null;
                cursor?: string | null;
                limit?: number;
                mission_id?: string | null;
                mission_ids?: string[];
                operation?: string | null;
                person?: string | null;
                person_id?: string | null;
                project_id?: string | null;
                project_ids?: string[];
                resource_id?: string | null;
                resource_type?: string | null;
                share_id?: string | null;
                since?: string | null;
                token?: string | null;
                token_id?: string | null;
                until?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_AuditRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    export_audit_events: {
        parameters: {
            query?: {
                as_admin?: boolean | null;
                mission_id?: string | null;
                mission_ids?: string[];
                operation?: string | null;
                person?: string | null;
                person_id?: string | null;
                project_id?: string | null;
                project_ids?: string[];
                resource_id?: string | null;
                resource_type?: string | null;
                share_id?: string | null;
                since?: string | null;
                token?: string | null;
                token_id?: string | null;
                until?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description One event a line. */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/jsonl": string;
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    bootstrap_admin: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["AdminBootstrap"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    approve_cli_login: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["LoopbackApproval"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["LoopbackApproved"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    exchange_cli_code: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["CliExchange"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["SignedIn"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_code: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["CodeSignIn"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["CodeRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    begin_device_login: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["DeviceBegin"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["DeviceCode"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    approve_device_login: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["DeviceDecision"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["DeviceRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    deny_device_login: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["DeviceDecision"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["DeviceRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_device_login: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["DeviceDecision"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["DeviceRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    exchange_device_code: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["DeviceExchange"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["SignedIn"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    accept_invitation: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["InvitationAccept"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    sign_in_by_link: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["CodeSignIn"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_sign_in_methods: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["SignInMethods"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_owner_link: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["OneTimeLink"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    sign_in_by_password: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["PasswordSignIn"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    change_password: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["PasswordChange"];
            };
        };
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    reauthenticate_by_password: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["PasswordReauthenticate"];
            };
        };
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    begin_provider_sign_in: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                name: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ProviderBegin"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProviderBegun"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    link_provider: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                name: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ProviderBegin"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProviderBegun"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    begin_provider_reauthentication: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                name: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ProviderBegin"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProviderBegun"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    reset_password: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["PasswordReset"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["BrowserSignedIn"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    sign_out: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    watch_events: {
        parameters: {
            query?: {
                /** @description The id of the last event received, as in Last-Event-ID. */
                after?: string | null;
                /** @description Duration of the stream in seconds. */
                for_s?: number;
            };
            header?: {
                "last-event-id"?: string | null;
            };
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Server-sent events. */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "text/event-stream": unknown;
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_files: {
        parameters: {
            query?: {
                check?: string[];
                content?: components["schemas"]["ContentState"][];
                count?: boolean;
                cursor?: string | null;
                event?: string[];
                finding?: string[];
                format?: string[];
                label?: string[];
                limit?: number;
                max_duration_ns?: number | null;
                max_size_bytes?: number | null;
                message_type?: string[];
                metric?: string[];
                min_duration_ns?: number | null;
                min_size_bytes?: number | null;
                mission?: string | null;
                mission_id?: string | null;
                missions?: string[];
                month?: string[];
                path?: string[];
                problem?: string[];
                project?: string | null;
                project_id?: string | null;
                projects?: string[];
                query?: string | null;
                recorded_after?: string | null;
                recorded_before?: string | null;
                recording_id?: string | null;
                sort?: components["schemas"]["FileSort"];
                state?: components["schemas"]["BlobState"][];
                text?: string | null;
                topic?: string[];
                verdict?: components["schemas"]["Verdict"][];
                where?: string[];
                without?: string[];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_FileRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_file: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["FileRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_file: {
        parameters: {
            query?: {
                dry_run?: boolean;
            };
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Deleted"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_file: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["FileUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["FileRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_lineage: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["LineageRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_recording_preview: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RecordingPreviewRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    make_recording_preview: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            202: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RecordingPreviewRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_recording_preview: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RecordingPreviewRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    slice_file: {
        parameters: {
            query?: {
                end?: string | null;
                start?: string | null;
                topics?: string[];
            };
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description An MCAP. */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/octet-stream": unknown;
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_file_topics: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_TopicRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    verify_file: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                file_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            202: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["FileRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    download_files: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["DownloadRequest"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["DownloadLinks"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    label_files: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["LabelChange"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["FilesLabelled"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_file_thumbnails: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ThumbnailsRequest"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["FileThumbnails"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_findings: {
        parameters: {
            query?: {
                action?: string | null;
                action_id?: string | null;
                code?: string | null;
                count?: boolean;
                cursor?: string | null;
                latest?: boolean;
                limit?: number;
                mission_id?: string | null;
                mission_ids?: string[];
                project_id?: string | null;
                project_ids?: string[];
                run_id?: string | null;
                severity?: components["schemas"]["Severity"][];
                topic?: string | null;
                version?: number | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_FindingRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_groups: {
        parameters: {
            query?: {
                count?: boolean;
                cursor?: string | null;
                limit?: number;
                name?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_GroupRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_group: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["GroupCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["GroupRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_group: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                group_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["GroupRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_group: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                group_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_group: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                group_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["GroupUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["GroupRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_group_members: {
        parameters: {
            query?: {
                count?: boolean;
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                group_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_MemberRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    set_group_member: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                group_id: string;
                person_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["MemberSet"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MemberRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    remove_group_member: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                group_id: string;
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_home: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["HomeRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_home_storage: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["HomeStorage"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_library: {
        parameters: {
            query?: {
                project_id?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["LibraryRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    add_from_library: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                name: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["LibraryAdd"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ActionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_me: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MeRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_account: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["AccountRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_identities: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["IdentityRead"][];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    unlink_identity: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                identity_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_sessions: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_SessionRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    end_all_sessions: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    end_session: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                session_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    begin_totp: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["TotpEnrolment"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    disable_totp: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    confirm_totp: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["TotpConfirm"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RecoveryCodes"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    renew_recovery_codes: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RecoveryCodes"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_metrics: {
        parameters: {
            query?: {
                action?: string | null;
                action_id?: string | null;
                mission_id?: string | null;
                mission_ids?: string[];
                project_id?: string | null;
                project_ids?: string[];
                version?: number | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MetricNames"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_metric_table: {
        parameters: {
            query: {
                action?: string | null;
                action_id?: string | null;
                aggregate?: components["schemas"]["Aggregate"];
                all_rows?: boolean;
                better?: components["schemas"]["Better"] | null;
                columns?: string[];
                compare?: string[];
                digits?: number;
                metric: string;
                mission_id?: string | null;
                mission_ids?: string[];
                project_id?: string | null;
                project_ids?: string[];
                query?: string | null;
                rows?: string;
                text?: components["schemas"]["TextFormat"] | null;
                topic?: string | null;
                version?: number | null;
                where?: string[];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MetricTableRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_mission_events: {
        parameters: {
            query?: {
                after?: string | null;
                before?: string | null;
                count?: boolean;
                cursor?: string | null;
                label?: string[];
                limit?: number;
                mission_id?: string | null;
                mission_ids?: string[];
                name?: string[];
                project_id?: string | null;
                project_ids?: string[];
                run_id?: string | null;
                sort?: components["schemas"]["MissionEventSort"];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_MissionEventRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_mission_event: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                event_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionEventRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_mission_event: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                event_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_mission_event: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                event_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["MissionEventUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionEventRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_mission_positions: {
        parameters: {
            query?: {
                check?: string[];
                completed?: boolean | null;
                event?: string[];
                finding?: string[];
                message_type?: string[];
                metric?: string[];
                missions?: string[];
                name?: string | null;
                project?: string | null;
                project_id?: string | null;
                projects?: string[];
                query?: string | null;
                recorded_after?: string | null;
                recorded_before?: string | null;
                satisfied?: boolean | null;
                text?: string | null;
                topic?: string[];
                verdict?: components["schemas"]["Verdict"][];
                where?: string[];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionPositions"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_missions: {
        parameters: {
            query?: {
                check?: string[];
                completed?: boolean | null;
                count?: boolean;
                cursor?: string | null;
                event?: string[];
                finding?: string[];
                limit?: number;
                message_type?: string[];
                metric?: string[];
                missions?: string[];
                name?: string | null;
                project?: string | null;
                project_id?: string | null;
                projects?: string[];
                query?: string | null;
                recorded_after?: string | null;
                recorded_before?: string | null;
                satisfied?: boolean | null;
                sort?: components["schemas"]["MissionSort"] | string;
                text?: string | null;
                topic?: string[];
                verdict?: components["schemas"]["Verdict"][];
                where?: string[];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_MissionRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_mission: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_mission: {
        parameters: {
            query?: {
                dry_run?: boolean;
            };
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Deleted"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_mission: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["MissionUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_mission_access: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_AccessRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    accept_check: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["CheckAcceptanceCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["CheckAcceptanceRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    withdraw_acceptance: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                acceptance_id: string;
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["CheckAcceptanceRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_check_note: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["CheckNoteCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["CheckNoteRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_check_note: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
                note_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_check_report: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["CheckReportCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["CheckReportRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_mission_checks: {
        parameters: {
            query?: {
                all?: boolean;
                cursor?: string | null;
                limit?: number;
                name?: string | null;
                status?: components["schemas"]["CheckStatus"][];
            };
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionChecksRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_mission_event: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["MissionEventCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionEventRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_mission_grants: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_GrantRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_mission_grant: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["GrantCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["GrantRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_mission_grant: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                grant_id: string;
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_mission_grant: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                grant_id: string;
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["GrantUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["GrantRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_mission_previews: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionPreviews"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_recordings: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_RecordingRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_share: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ShareCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ShareMade"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_mission_timeline: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionTimeline"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_mission_topics: {
        parameters: {
            query?: {
                bins?: number;
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionTopics"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_uploads: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_UploadRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    begin_uploads: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                mission_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["UploadBegin"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["UploadDecisions"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_mission_pictures: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["PicturesRequest"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionPictures"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_overview: {
        parameters: {
            query?: {
                by?: string;
                max_buckets?: number;
                project_id?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Overview"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_people: {
        parameters: {
            query?: {
                active?: boolean | null;
                count?: boolean;
                cursor?: string | null;
                limit?: number;
                text?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_PersonRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_person: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["PersonRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    make_admin: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["PersonRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    unmake_admin: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["PersonRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    deactivate_person: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Departure"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    erase_person: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["PersonErase"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Erasure"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_erasure: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Erasure"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    export_person: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description One record a line. */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/jsonl": string;
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    reactivate_person: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["PersonRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_reset_link: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["OneTimeLink"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    reset_totp: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                person_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    invite_person: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["InvitationCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["OneTimeLink"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_projects: {
        parameters: {
            query?: {
                count?: boolean;
                cursor?: string | null;
                limit?: number;
                name?: string | null;
                sort?: components["schemas"]["ProjectSort"];
                text?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_ProjectRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_project: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ProjectCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProjectRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_project: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProjectRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_project: {
        parameters: {
            query?: {
                dry_run?: boolean;
            };
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Deleted"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_project: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ProjectUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProjectRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_project_access: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_AccessRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_project_actions: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProjectActionList"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    add_project_action: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ProjectActionAdd"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProjectActionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    remove_project_action: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                action_id: string;
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_project_checks: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProjectChecksRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    set_project_checks: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ProjectChecksUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProjectChecksRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_check_matrix: {
        parameters: {
            query?: {
                count?: boolean;
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["CheckMatrix"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_check_trend: {
        parameters: {
            query?: {
                by?: components["schemas"]["TrendStep"];
            };
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["CheckTrend"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_checks_versions: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_ChecksVersionRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_checks_version: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                number: number;
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ProjectChecksRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_project_grants: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_GrantRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_project_grant: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["GrantCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["GrantRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_project_grant: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                grant_id: string;
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_project_grant: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                grant_id: string;
                project_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["GrantUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["GrantRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_mission: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["MissionCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_project_stats: {
        parameters: {
            query?: {
                by?: string;
                max_buckets?: number;
            };
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Overview"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_mission_template: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["MissionTemplate"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_viewer_layouts: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_ViewerLayoutRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_viewer_layout: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                project_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ViewerLayoutCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ViewerLayoutRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    delete_viewer_layout: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                layout_id: string;
                project_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    update_viewer_layout: {
        parameters: {
            query?: never;
            header?: {
                /** @description The `etag` of the object that was edited, in quotes. */
                "If-Match"?: string | null;
            };
            path: {
                layout_id: string;
                project_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ViewerLayoutUpdate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ViewerLayoutRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_recording: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                recording_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RecordingRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_run_checks: {
        parameters: {
            query?: {
                action?: string | null;
                action_id?: string | null;
                count?: boolean;
                cursor?: string | null;
                latest?: boolean;
                limit?: number;
                mission_id?: string | null;
                mission_ids?: string[];
                name?: string | null;
                project_id?: string | null;
                project_ids?: string[];
                run_id?: string | null;
                status?: components["schemas"]["CheckStatus"][];
                topic?: string | null;
                version?: number | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_CheckRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_run_metrics: {
        parameters: {
            query?: {
                action?: string | null;
                action_id?: string | null;
                count?: boolean;
                cursor?: string | null;
                latest?: boolean;
                limit?: number;
                mission_id?: string | null;
                mission_ids?: string[];
                name?: string | null;
                project_id?: string | null;
                project_ids?: string[];
                run_id?: string | null;
                topic?: string | null;
                version?: number | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_MetricRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_run_context: {
        parameters: {
            query: {
                attempt: number;
            };
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunContext"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    finish_run: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["RunFinish"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunFinished"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    sign_inputs: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["InputsRequest"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["InputUrls"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_log_chunk: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["LogChunkCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["LogChunkUpload"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    confirm_log_chunk: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["LogChunkConfirm"];
            };
        };
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_artifact_uploads: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ArtifactUploadsCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["UploadDecisions"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_runners: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_RunnerRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    register_runner: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["RunnerRegistration"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunnerRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    claim_run: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                runner_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ClaimRequest"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ClaimReply"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_run_contexts: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                runner_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ContextsRequest"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunContexts"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    finish_runs: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                runner_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["RunEnds"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunEndsRecorded"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    send_heartbeats: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                runner_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["Heartbeats"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["HeartbeatReplies"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_runs: {
        parameters: {
            query?: {
                action?: string | null;
                action_id?: string | null;
                active?: boolean | null;
                count?: boolean;
                cursor?: string | null;
                isolation?: components["schemas"]["Isolation"][];
                job_id?: string | null;
                limit?: number;
                mine?: boolean;
                mission_id?: string | null;
                mission_ids?: string[];
                node?: string | null;
                project_id?: string | null;
                project_ids?: string[];
                state?: components["schemas"]["RunState"][];
                verdict?: ("good" | "warnings" | "bad")[];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_RunRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_runs: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["RunsCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunsCreated"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_run: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunDetail"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_artifacts: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_ArtifactRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    download_artifacts: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["ArtifactsRequest"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ArtifactUrls"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    cancel_run: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_run_inputs: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
            };
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_RunInput_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_run_log: {
        parameters: {
            query?: {
                offset?: number;
                wait_s?: number;
            };
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["LogChunkRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    retry_run: {
        parameters: {
            query?: {
                force?: boolean;
            };
            header?: never;
            path: {
                run_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    record_run: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["RunRecord"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["RunRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    search: {
        parameters: {
            query?: {
                limit?: number;
                query?: string;
                sort?: components["schemas"]["FileSort"];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["SearchRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_facets: {
        parameters: {
            query?: {
                query?: string;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["FacetsRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_service: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["ServiceRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_share: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["SharedRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_shares: {
        parameters: {
            query?: {
                cursor?: string | null;
                ended?: boolean;
                limit?: number;
                mission_id?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_ShareRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    revoke_share: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                share_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_stats: {
        parameters: {
            query?: {
                by?: string;
                check?: string[];
                content?: components["schemas"]["ContentState"][];
                derived?: boolean;
                event?: string[];
                finding?: string[];
                format?: string[];
                label?: string[];
                max_duration_ns?: number | null;
                max_size_bytes?: number | null;
                message_type?: string[];
                metric?: string[];
                min_duration_ns?: number | null;
                min_size_bytes?: number | null;
                mission?: string | null;
                mission_id?: string | null;
                missions?: string[];
                month?: string[];
                path?: string[];
                problem?: string[];
                project?: string | null;
                project_id?: string | null;
                projects?: string[];
                query?: string | null;
                recorded_after?: string | null;
                recorded_before?: string | null;
                recording_id?: string | null;
                state?: components["schemas"]["BlobState"][];
                text?: string | null;
                topic?: string[];
                verdict?: components["schemas"]["Verdict"][];
                where?: string[];
                without?: string[];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["StatsRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_tokens: {
        parameters: {
            query?: {
                cursor?: string | null;
                ended?: boolean;
                everybody?: boolean;
                limit?: number;
                person_id?: string | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_TokenRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    create_token: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["TokenCreate"];
            };
        };
        responses: {
            /** @description Successful Response */
            201: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["TokenMade"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    revoke_token: {
        parameters: {
            query?: {
                made?: components["schemas"]["DerivedTokens"];
            };
            header?: never;
            path: {
                token_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_topics: {
        parameters: {
            query?: {
                check?: string[];
                content?: components["schemas"]["ContentState"][];
                count?: boolean;
                cursor?: string | null;
                event?: string[];
                finding?: string[];
                format?: string[];
                label?: string[];
                limit?: number;
                max_duration_ns?: number | null;
                max_size_bytes?: number | null;
                message_type?: string[];
                metric?: string[];
                min_duration_ns?: number | null;
                min_size_bytes?: number | null;
                mission?: string | null;
                mission_id?: string | null;
                missions?: string[];
                month?: string[];
                path?: string[];
                problem?: string[];
                project?: string | null;
                project_id?: string | null;
                projects?: string[];
                query?: string | null;
                recorded_after?: string | null;
                recorded_before?: string | null;
                recording_id?: string | null;
                state?: components["schemas"]["BlobState"][];
                text?: string | null;
                topic?: string[];
                verdict?: components["schemas"]["Verdict"][];
                where?: string[];
                without?: string[];
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_TopicRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    list_trash: {
        parameters: {
            query?: {
                cursor?: string | null;
                limit?: number;
                resource_type?: components["schemas"]["TrashResourceType"] | null;
            };
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["Page_TrashRead_"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    restore_from_trash: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                resource_id: string;
                resource_type: components["schemas"]["TrashResourceType"];
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    get_upload: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                upload_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["UploadRead"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    abort_upload: {
        parameters: {
            query?: never;
            header?: never;
            path: {
                upload_id: string;
            };
            cookie?: never;
        };
        requestBody?: never;
        responses: {
            /** @description Successful Response */
            204: {
                headers: {
                    [name: string]: unknown;
                };
                content?: never;
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    complete_uploads: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["UploadsComplete"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["UploadOutcomes"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
    sign_parts: {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        requestBody: {
            content: {
                "application/json": components["schemas"]["PartsSign"];
            };
        };
        responses: {
            /** @description Successful Response */
            200: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/json": components["schemas"]["SignedParts"];
                };
            };
            /** @description A failure as a problem document (RFC 9457), identified by `code`. */
            default: {
                headers: {
                    [name: string]: unknown;
                };
                content: {
                    "application/problem+json": components["schemas"]["ProblemDocument"];
                };
            };
        };
    };
}
