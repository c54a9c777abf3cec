"""Types of the API: requests, responses and errors that server and clients share, and their validation rules."""
